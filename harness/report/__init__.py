"""Results to self-contained pages."""

import importlib
import os
import sys


def _load_matplotlib() -> None:
    """Load matplotlib also where `MPLBACKEND` names a backend that it does not know: pages need none."""
    try:
        importlib.import_module("matplotlib")
    except ValueError:
        for name in [each for each in sys.modules if each.partition(".")[0] == "matplotlib"]:
            del sys.modules[name]
        backend = os.environ.pop("MPLBACKEND", None)
        if backend is None:
            raise
        try:
            importlib.import_module("matplotlib")
        finally:
            os.environ["MPLBACKEND"] = backend


_load_matplotlib()
