"""The moves of each stage: drawn, chosen, refined, and the standard errors that they will give."""
