"""Checks of torque against motion: friction, the robot's equations, causes of a misfit."""
