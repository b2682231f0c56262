"""Moves within the limits: Fourier moves, strokes at constant speed, their files."""
