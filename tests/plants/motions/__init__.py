"""Reference motions, and the logs that stages need of them."""
