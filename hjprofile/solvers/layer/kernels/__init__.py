"""Compiled loops of layer."""
