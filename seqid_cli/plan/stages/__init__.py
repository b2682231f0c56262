"""The moves of each stage: drawn, chosen, refined, and the errors that they promise."""
