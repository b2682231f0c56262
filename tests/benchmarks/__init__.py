"""What the work costs, against what one would use otherwise."""
