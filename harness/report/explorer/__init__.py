"""The explorer of the base trial: its data, and the scripts that show them."""
