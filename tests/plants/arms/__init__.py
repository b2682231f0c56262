"""The simulated arms, and what their drives are made for."""
