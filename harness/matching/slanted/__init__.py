"""Slanted windows fitted to the raw mirror images: the refinement near the Cramér-Rao bound."""
