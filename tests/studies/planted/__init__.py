"""Planted faults against the stages that read them."""
