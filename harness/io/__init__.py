"""Files of the outside world: how a view is laid down and read, and the calibration files of other programs."""
