"""Which samples of the logs count, and which stretches are events."""
