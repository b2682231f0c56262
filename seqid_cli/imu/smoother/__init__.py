"""Motion by encoders and IMUs together: a smoother along the whole chain."""
