"""Localisation by appearance: images at known positions, descriptors of whole images, a density over positions."""
