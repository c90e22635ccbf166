"""Pictures of runs and studies; the only room that knows matplotlib. Drawn off screen, without pyplot."""
