"""What an identified model cannot explain: find it, trace it to an effect, add it, prove it."""
