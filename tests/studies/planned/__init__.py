"""Planned moves against chance, a peer, and what comes of them."""
