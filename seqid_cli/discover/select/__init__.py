"""Selection of what a model lacks: one list of terms, one score, one null."""
