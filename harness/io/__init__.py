"""Files of the outside world: how a view is laid down and read."""
