"""Reproducible measurements on simulated and recorded robots, printed as Markdown
tables.
"""
