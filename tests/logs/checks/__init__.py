"""Tests of `logs.checks`."""
