"""Drawings of measured and predicted torque: over time, over motion, and as spectra."""
