"""Torques that an identified model predicts, and the files that hold them."""
