"""Codes of findings with their remedies, and findings made of them."""
