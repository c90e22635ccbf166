"""Laws of linear growth: vertical steps on grids and by fronts (§16)."""
