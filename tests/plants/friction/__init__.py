"""Friction of joints as physics."""
