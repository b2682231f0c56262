"""Tests of `logs.messages`."""
