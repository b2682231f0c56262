"""Error bands of predicted torques.

They are calibrated on left-out logs, stated with a prediction, and checked on new logs.
"""
