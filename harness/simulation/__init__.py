"""Synthetic scenes with ground truth: the image that a sensor sees, and the range of every pixel.

Nothing here depends on stereo.
"""
