"""Effects: their columns, and that their parameters come back from torque made another
way.
"""
