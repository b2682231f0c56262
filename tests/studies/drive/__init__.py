"""Studies of the drives behind the torques."""
