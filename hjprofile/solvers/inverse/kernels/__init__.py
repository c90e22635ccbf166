"""Compiled loops of x as a function of u."""
