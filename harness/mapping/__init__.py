"""Range profiles, scan files and occupancy maps from a robot's range estimates."""
