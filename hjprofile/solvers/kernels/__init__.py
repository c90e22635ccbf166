"""Every compiled loop: arrays and floats in, arrays and floats out. The only room that knows numba."""

from contextlib import suppress
from functools import wraps

import numba
import numpy as np
from numba.extending import overload

from hjprofile.solvers.kernels.disk_cache import KernelCache


def compiled(function, **options):
    """numba.njit with a cache on disk where there is a writable place for it."""
    if numba.config.DISABLE_JIT:
        return _interpreted(function)
    # error_model="numpy": without the check for division by zero loops vectorise
    loop = numba.njit(error_model="numpy", **options)(function)
    with suppress(RuntimeError):  # no place for the cache
        loop._cache = KernelCache(function)
    return loop


def vectorised(function):
    """`compiled`, where a product and a sum may be rounded once instead of twice."""
    return compiled(function, fastmath={"contract"})


def by_type(choose):
    """A function for loops whose code is chosen by type: `choose` takes the types of the arguments."""
    known = {}

    @wraps(choose)
    def chosen(*arguments):  # only where nothing is compiled
        kinds = tuple(map(type, arguments))
        if kinds not in known:
            known[kinds] = choose(*map(numba.typeof, arguments))
        return known[kinds](*arguments)

    overload(chosen)(choose)
    return chosen


def _interpreted(function):
    """The loop by Python itself, as NUMBA_DISABLE_JIT asks, which divides by zero as compiled loops do."""

    @wraps(function)
    def loop(*arguments):
        with np.errstate(all="ignore"):
            return function(*(np.float64(a) if isinstance(a, float) else a for a in arguments))

    return loop
