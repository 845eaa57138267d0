"""The command line: the only place that prints, parses arguments or exits."""

from harness.cli.parser import main

__all__ = ["main"]
