"""Data sets: pairs with their truth over random scenes, made, checked, and used to score estimates."""
