"""Simulated robots, written apart from the package that identifies them."""
