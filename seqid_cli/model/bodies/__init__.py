"""Bodies that can exist, nearest to what was identified."""
