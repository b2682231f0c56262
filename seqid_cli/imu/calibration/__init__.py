"""Mounting, lever, clock offset and sensor constants of a robot's IMUs (Eq. 29-38)."""
