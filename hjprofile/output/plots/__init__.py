"""Pictures of runs and studies; the only package that imports matplotlib.

They are drawn off screen without pyplot, except for `user_axes.py`.
"""

import logging
import os
import sys
from contextlib import suppress


def _import_matplotlib() -> None:
    """Import matplotlib without a line on stderr, also where MPLBACKEND names a backend that it does not have."""
    logger = logging.getLogger("matplotlib")  # warns of unknown keys and unwritable caches
    level, backend = logger.level, os.environ.pop("MPLBACKEND", None)
    logger.setLevel(logging.CRITICAL)
    try:
        import matplotlib

        if backend is not None:
            with suppress(ValueError):  # for pictures of the user; those of this package need no backend
                matplotlib.rcParams["backend"] = backend
    finally:
        logger.setLevel(level)
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


if "matplotlib" not in sys.modules:
    _import_matplotlib()
