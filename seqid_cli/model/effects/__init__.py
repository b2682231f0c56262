"""Physical effects beyond rigid body, friction surface and rotor inertia, one file each."""
