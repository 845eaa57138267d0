"""The geometry of two views, of any camera: directions, poses, the panorama's grid, epipolar curves, triangulation."""
