"""Tests of the second simulator."""
