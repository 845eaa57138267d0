"""Estimates against the truth: errors per pixel, and the figures that sum them up."""
