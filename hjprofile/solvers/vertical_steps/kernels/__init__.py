"""Compiled loops of vertical steps."""
