"""Is it right: the consistency test and observed orders."""
