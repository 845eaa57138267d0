"""A simulation-driven evaluation harness for omnidirectional (catadioptric) stereo."""

__version__ = "0.1.0"
