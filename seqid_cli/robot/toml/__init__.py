"""The robot file: its schema, reading, checks, and a template to begin with."""
