"""Physical effects beyond rigid body, friction surface and rotor: one file each."""
