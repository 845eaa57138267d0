"""OpenCV's matchers, through the same interface as the others."""
