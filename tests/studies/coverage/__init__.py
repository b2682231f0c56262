"""Stated errors against truth, over drawn arms."""
