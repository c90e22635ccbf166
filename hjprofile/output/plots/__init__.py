"""Pictures of runs and studies; the only room that knows matplotlib. Drawn off screen, without pyplot."""

import logging
import os


def _import_matplotlib() -> None:
    """Import matplotlib without a line on stderr, also where MPLBACKEND names a backend that it does not have."""
    logger = logging.getLogger("matplotlib")  # of an unknown key in a matplotlibrc, of a cache that cannot be written
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        import matplotlib
    except ValueError:
        backend = os.environ.pop("MPLBACKEND")
        try:
            import matplotlib  # noqa: F401
        finally:
            os.environ["MPLBACKEND"] = backend
    finally:
        logger.setLevel(level)


_import_matplotlib()
