"""The sensor: a camera of one of the central models, and what its images become.

Nothing here depends on scenes or on stereo.
"""
