"""The explorer of the base trial: what the page is given, and the scripts that show it."""
