"""What a robot makes of ranges: range profiles, files of scans, and maps."""
