"""The moves of each stage: drawn, chosen, refined, with their predicted standard errors."""
