"""Friction of each joint over position and velocity, from constant-velocity trials (Eq. 7-16)."""
