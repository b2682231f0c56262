"""A fleet of robots, and those that drift."""
