"""Every compiled loop: arrays and floats in, arrays and floats out. The only room that knows numba."""

import numba


def compiled(function, **options):
    """numba.njit with a cache on disk where there is a writable place for it."""
    # error_model="numpy": without the check for division by zero loops vectorise
    try:
        return numba.njit(cache=True, error_model="numpy", **options)(function)
    except RuntimeError:  # no place for the cache
        return numba.njit(error_model="numpy", **options)(function)


def vectorised(function):
    """`compiled`, where a product and a sum may be rounded once instead of twice."""
    return compiled(function, fastmath={"contract"})
