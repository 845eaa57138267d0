"""From two mirror images to range: panorama, filter, epipolar curves, matching, triangulation.

Nothing here knows of scenes or of the truth.
"""
