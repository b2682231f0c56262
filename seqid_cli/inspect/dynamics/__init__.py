"""Checks of torque against motion: friction, the robot's equations, and what mends them."""
