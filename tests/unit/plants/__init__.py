"""Tests of the simulated robots."""
