"""Motion from two images: features, a robust start, least squares on bearings and on grey levels, a verdict."""
