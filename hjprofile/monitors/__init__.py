"""What watches a run from outside: the kinks, and the facts and budgets that a run must respect."""
