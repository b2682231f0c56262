"""The torque model: friction surface, rigid body, and their sum."""
