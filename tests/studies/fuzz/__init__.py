"""Damaged and hostile files for every reader and parser, through the program's own
front door.
"""
