"""Compiled loops of characteristics."""
