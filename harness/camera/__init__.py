"""The sensor: a perspective camera that looks up into a hyperboloid mirror, and where it stands.

Nothing here knows of scenes or of stereo.
"""
