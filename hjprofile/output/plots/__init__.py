"""Pictures of runs and studies; the only room that knows matplotlib. Drawn off screen, without pyplot."""

import logging
import os
import sys
from contextlib import suppress


def _import_matplotlib() -> None:
    """Import matplotlib without a line on stderr, also where MPLBACKEND names a backend that it does not have."""
    logger = logging.getLogger("matplotlib")  # of an unknown key in a matplotlibrc, of a cache that cannot be written
    level, backend = logger.level, os.environ.pop("MPLBACKEND", None)
    logger.setLevel(logging.CRITICAL)
    try:
        import matplotlib

        if backend is not None:
            with suppress(ValueError):  # for the user's own pictures; those of this package need none
                matplotlib.rcParams["backend"] = backend
    finally:
        logger.setLevel(level)
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


if "matplotlib" not in sys.modules:
    _import_matplotlib()
