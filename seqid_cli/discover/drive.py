"""Rows of the drive alone, where a torque sensor behind the gear tells what the link takes.

The motor's torque less the sensor's is what the drive takes,

    tau_m - tau_l = k tau_l + I ddq + f(dq, q, tau_l) + c,

friction f and the rotor's inertia I, with an error k by which motor and sensor disagree about a
torque and a zero c of the sensor. What a model gets wrong of the link, and what else acts on it, is
not in these rows: it does not hide an effect of the drive there, nor pass for one. They are further
channels, one per joint, beside the rows of the motor's whole torque.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.discover.base import LIKELY, residual_of
from seqid_cli.discover.select.rows import Part
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array


@dataclass(frozen=True)
class DriveRows:
    """Rows of each joint's drive; empty where no joint has a torque sensor.

    `y[j]` (M_j,) is what the file's model leaves of motor torque less the sensor's [N m], M_j zero
    without a sensor; `columns[j]` (M_j, 3) the sensor's torque, the rotor's acceleration, a
    constant.
    """

    y: tuple[Array, ...] = ()
    columns: tuple[Array, ...] = ()

    def of(self, joint: int) -> bool:
        """Whether a joint has such rows."""
        return bool(self.y) and len(self.y[joint]) > 0

    def part(self, joint: int, channel: int, size: float, *, disagree: float = 0.05) -> Part:
        """What is free beside friction; `size` [N m] is what the file leaves.

        By `disagree` motor and sensor may tell another torque: the robot file says so, by its
        torque constants, and what leaves it tells against the file.
        """
        X = self.columns[joint]
        likely = np.mean(X**2, axis=0) / (LIKELY * size) ** 2
        own, of_file = np.diag(likely), np.diag([disagree**-2.0, 0.0, 0.0])
        own[0, 0] = 0.0
        return Part({channel: X}, own + of_file, own)


def drive_rows(rows: Rows) -> DriveRows:
    """Take the rows of drives whose joints have a torque sensor in all logs."""
    if any(scene.sensor is None for scene in rows.scenes):
        return DriveRows()
    every = [_values(scene) for scene in rows.scenes]
    own = [rows.torque(j, [values[:, j] for values in every]) for j in range(rows.n)]
    known = [X if np.isfinite(X).all() else X[:0] for X in own]
    return DriveRows(tuple(X[:, 0] for X in known), tuple(X[:, 1:] for X in known))


def _values(scene: Scene) -> Array:
    """What the file leaves of the drive's torque, then its columns: (N, n, 4), low-passed."""
    motion = scene.motion
    assert scene.sensor is not None
    sensor = motion.filtered(scene.sensor)
    left = residual_of(scene) - sensor + motion.filtered(scene.modelled_load)
    return np.stack([left, sensor, motion.filtered(motion.ddq), np.ones_like(left)], axis=-1)
