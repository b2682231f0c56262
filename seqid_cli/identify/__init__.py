"""One readable recipe per stage: friction, gravity, inertia, IMU calibration, prediction."""
