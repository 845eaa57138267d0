"""Calibration: from chessboard corners in images to a sensor and the covariance of its rays."""
