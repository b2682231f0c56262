"""The robot: its file, geometry, kinematics, torque regressor and base parameters."""
