"""What comes of planned moves."""
