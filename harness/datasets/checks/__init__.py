"""Checks of data sets: one file for each kind of fault, and the table of them in `check`."""
