"""OpenCV itself: an extra, loaded where it is used, so that all else works without it."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from harness.errors import InputError


def opencv(asks: str, extra: str = "peers") -> Any:
    """The module `cv2`, with OpenCV's contributed modules.

    Parameters
    ----------
    asks
        The matcher or the command that asks.
    extra
        The extra that brings it.

    Raises
    ------
    InputError
        When it is not installed, or without `cv2.omnidir`.
    """
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError:
        cv2 = None
    if not hasattr(cv2, "omnidir"):
        raise InputError(f"needs the extra: pip install 'omnirange[{extra}]'", file=asks)
    return cv2


@contextmanager
def threads(cv2: Any, number: int) -> Iterator[None]:
    """OpenCV's number of threads, a setting of the whole process, for a while. No disparity depends on it."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(number)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
