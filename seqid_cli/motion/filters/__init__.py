"""Low-pass, differentiation, and the choice of the cut-off."""
