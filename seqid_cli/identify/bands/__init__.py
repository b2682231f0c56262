"""How far predicted torques may be off: calibrated on left-out logs, stated and checked later."""
