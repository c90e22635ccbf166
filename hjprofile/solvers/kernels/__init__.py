"""Compilation of the loops by numba, with a cache on disk.

No other package imports numba. Compiled loops take and return arrays and floats.
"""

from contextlib import suppress
from functools import wraps

import numba
import numpy as np
from numba.extending import overload, register_jitable

from hjprofile.solvers.kernels.disk_cache import KernelCache


def compiled(function, **options):
    """Compile a function by numba.njit, with a cache on disk if a folder for it can be written."""
    if numba.config.DISABLE_JIT:
        return _interpreted(function)
    # error_model="numpy": without the check for division by zero loops vectorise
    # no_cfunc_wrapper: no entry for callbacks from C, which would take a tenth of the compilation
    loop = numba.njit(error_model="numpy", no_cfunc_wrapper=True, **options)(function)
    with suppress(RuntimeError):  # no folder for the cache can be written
        loop._cache = KernelCache(function)
    return loop


def vectorised(function):
    """Compile a function as `compiled` does; a product and a sum may be rounded once instead of twice."""
    return compiled(function, fastmath={"contract"})


def inner(function):
    """Prepare a function that loops call and Python does not: it is compiled into each loop that calls it.

    It has no entry for calls from Python and no file in the cache, which halves the seconds of its compilation. A call
    from Python, as in a test, runs it as Python. It is compiled twice if a function marked by `compiled` and one marked
    by `inner` call it.
    """
    if numba.config.DISABLE_JIT:
        return _interpreted(function)
    # the options are those of `compiled`, also in a loop with other options
    return register_jitable(error_model="numpy", no_cfunc_wrapper=True, fastmath=False)(function)


def inlined(function):
    """Prepare a function as `inner` does, for `vectorised` loops; LLVM puts its code into each loop that calls it.

    A call would copy the descriptions of its arrays and count references to them, which takes longer than 64 lanes.
    """
    if numba.config.DISABLE_JIT:
        return _interpreted(function)
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, "fastmath": {"contract"}, "forceinline": True}
    return register_jitable(**options)(function)


def by_type(choose):
    """Return a function for loops whose code is chosen by type: `choose` takes the types of the arguments."""
    known = {}

    @wraps(choose)
    def chosen(*arguments):  # as Python, also if compilation is disabled
        kinds = tuple(map(type, arguments))
        if kinds not in known:
            known[kinds] = choose(*map(numba.typeof, arguments))
        return known[kinds](*arguments)

    overload(chosen, jit_options={"forceinline": True})(choose)
    return chosen


def _interpreted(function):
    """Return the loop as Python runs it under NUMBA_DISABLE_JIT; it divides by zero as compiled loops do."""

    @wraps(function)
    def loop(*arguments):
        with np.errstate(all="ignore"):
            return function(*(np.float64(a) if isinstance(a, float) else a for a in arguments))

    return loop
