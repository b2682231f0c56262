"""What a model can lack in the second simulator."""
