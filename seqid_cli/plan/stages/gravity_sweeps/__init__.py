"""Slow sweeps for gravity: where they may go, how a set is judged, found and predicted."""
