"""Drawings of the report: SVG, charts, and the figures of each kind of result."""
