"""Shock-fitted characteristics."""
