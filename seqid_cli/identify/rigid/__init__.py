"""Rigid-body parameters: gravity, inertia, or all in one least squares (Eq. 5-26)."""
