"""The sensor: a camera of one of the central models, and what its images become.

Nothing here knows of scenes or of stereo.
"""
