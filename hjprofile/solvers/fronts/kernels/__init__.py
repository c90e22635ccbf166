"""Compiled loops of fronts."""
