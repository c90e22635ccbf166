"""Grids: schemes for u and for q, time stepping, and what watches it."""
