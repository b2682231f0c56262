"""IMUs: their calibration, and motion from them."""
