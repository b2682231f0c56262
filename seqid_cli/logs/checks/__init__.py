"""What is wrong with the samples of a log, and how it is put right."""
