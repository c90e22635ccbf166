"""Studies that use many runs."""
