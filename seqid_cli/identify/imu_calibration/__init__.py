"""Mounting, lever, clock offset and sensor constants of IMUs on the links (Eq. 29-38)."""
