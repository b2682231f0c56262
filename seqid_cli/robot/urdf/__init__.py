"""The URDF: its text and checks, its joints, and Pinocchio's model of it."""
