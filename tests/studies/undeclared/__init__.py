"""Effects that nobody declared: how often and how surely they are named."""
