"""Front tracking."""
