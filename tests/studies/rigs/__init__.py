"""The paper's rigs and a six-joint arm against truth and bounds."""
