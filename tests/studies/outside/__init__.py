"""A second simulator, in MuJoCo: it shares no code with `tests.plants`."""
