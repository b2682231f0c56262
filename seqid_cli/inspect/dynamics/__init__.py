"""Checks of torque against motion: friction, equations, causes of a misfit."""
