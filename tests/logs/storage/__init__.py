"""Tests of `logs.storage`."""
