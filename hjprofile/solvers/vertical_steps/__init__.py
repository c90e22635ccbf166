"""Laws of linear growth: vertical steps on grids and by fronts (theory, §14)."""
