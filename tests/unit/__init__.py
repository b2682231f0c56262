"""Tests of the parts of the package and of the programs beside it."""
