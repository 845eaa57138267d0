"""Windows of the filtered panoramas compared along the epipolar curve: the paper's, and those that follow its map."""
