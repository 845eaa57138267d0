"""Exit codes of the command."""

from harness.interrupts import EXIT_CODE as INTERRUPTED

OK, FAILED, INPUT, BUG = 0, 1, 2, 70
"""Success; a trial failed; invalid input; a bug in this program (70 is `EX_SOFTWARE`)."""

__all__ = ["BUG", "FAILED", "INPUT", "INTERRUPTED", "OK"]
