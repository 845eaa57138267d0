"""What the command exits with."""

from harness.interrupts import EXIT_CODE as INTERRUPTED

OK, FAILED, INPUT, BUG = 0, 1, 2, 70
"""All went well; a trial failed; something given is wrong; a fault of this program's (70 is `EX_SOFTWARE`)."""

__all__ = ["BUG", "FAILED", "INPUT", "INTERRUPTED", "OK"]
