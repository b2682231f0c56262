"""Tests of `logs.tables`."""
