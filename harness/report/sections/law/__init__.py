"""The law of the range error: the worked example, and its test in three ways."""
