"""Worlds with a known answer: what a sensor sees in a scene, and how far away everything is.

Nothing here depends on stereo.
"""
