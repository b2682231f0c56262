"""Linear least squares on logs of any length: equations, QR factors, weights, standard errors."""
