"""How an arm moves: rigid bodies, transmissions, drives and torques."""
