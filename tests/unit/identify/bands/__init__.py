"""Bands of predicted torques."""
