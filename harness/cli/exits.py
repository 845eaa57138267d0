"""What the command exits with."""

OK, FAILED, INPUT, INTERRUPTED = 0, 1, 2, 130
"""All went well; a trial failed; something given is wrong; Ctrl-C."""
