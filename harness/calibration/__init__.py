"""Calibration: from corners of chessboards in images to a sensor, and how sure its rays are."""
