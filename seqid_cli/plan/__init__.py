"""Which experiment to run next: motions within the limits, and the errors that they will give."""
