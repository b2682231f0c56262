"""Tests of `logs.mcap`."""
