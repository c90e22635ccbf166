"""Grids: schemes for u and for q, time stepping, and monitors."""
