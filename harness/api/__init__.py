"""The functions that `import harness` offers, and the objects that they return."""
