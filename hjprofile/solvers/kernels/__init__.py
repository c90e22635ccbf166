"""Every compiled loop: arrays and floats in, arrays and floats out. The only room that knows numba."""

from functools import wraps

import numba
from numba.extending import overload


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


def by_type(choose):
    """A function for compiled loops whose code is chosen by type: `choose` takes the types of the arguments."""

    @wraps(choose)
    def chosen(*arguments):
        raise NotImplementedError("for compiled loops only")

    overload(chosen)(choose)
    return chosen
