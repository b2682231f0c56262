"""Effects added to a model, decided on left-out blocks, confirmed on held-out logs."""
