"""Semi-global matching over alpha_2."""
