"""OpenCV's matchers, behind the same door as those here."""
