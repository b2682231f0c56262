"""Excerpts of logs that are too long to be held."""
