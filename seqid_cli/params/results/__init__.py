"""Documents beside the parameter file, as typed data: one kind to a file."""
