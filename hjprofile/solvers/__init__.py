"""The solution methods."""
