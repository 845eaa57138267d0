"""Views from other viewpoints, warped from images and their ranges."""
