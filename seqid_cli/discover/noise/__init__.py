"""Torque noise, what encoder noise makes of a residual, and the noise floor."""
