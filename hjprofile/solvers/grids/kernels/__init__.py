"""Compiled loops of grids."""
