"""Friction of each joint over position and velocity, from steady trials (Eq. 7-16)."""
