"""Checks of single channels: clock, holes, positions, velocities, torques."""
