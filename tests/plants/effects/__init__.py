"""What a study puts into a plant and its robot file does not say."""
