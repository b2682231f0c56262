"""Linear least squares on logs of any length: equations, QR, weights, errors."""
