"""x as a function of u: backward Euler steps with a projection onto the non-decreasing functions."""
