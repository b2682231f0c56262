"""The moves of each stage: drawn, chosen and refined; with predicted errors."""
