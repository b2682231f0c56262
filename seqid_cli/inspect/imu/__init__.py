"""Checks of IMUs: their readings by themselves, and against the motion of the link."""
