"""Moves within the limits: Fourier moves, strokes at constant speed, and their files."""
