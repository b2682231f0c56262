"""Slow sweeps for gravity: their space, their criterion, search and prediction."""
