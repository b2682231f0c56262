"""What is in a log and what is wrong with it, before anything is identified from it."""
