"""What is wrong with a data set: one file for each kind of fault, and the table of them in `check`."""
