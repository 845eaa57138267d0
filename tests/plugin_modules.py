"""Modules with matchers in them, for tests of plug-ins."""

from collections.abc import Callable

FAR = """
import numpy as np

def match(pair, limits, *, window=5, share=1.0):
    return pair.alpha_1 + share * window * 0.01 * np.sin(pair.alpha_1)
"""
"""A matcher that always answers, with what its parameters say."""

Write = Callable[[str], str]
"""Writes a module, and gives its name."""
