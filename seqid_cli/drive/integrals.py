"""Where the integral of a controller stands at rows of a log.

A log holds the error that a controller has summed up, but for one number of each
stretch in which it went by its law. With the mean over such a stretch written as < >,
the integral S at a time t is

    S(t) = s(t) - <s> + (<tau> - kp <c - q> + kd <q'> - ... - b) / ki,

s the sum of the error since the log began. The torque at t itself says far less: where
a joint turns round, no model knows its friction, and an integral that begins wrong by
it takes seconds to forget.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from seqid_cli.drive.equations import (
    INTEGRAL,
    Delays,
    JointLaw,
    stretches,
    summed_error,
    telling_rows,
)
from seqid_cli.drive.limits import NEAR_LIMIT, below
from seqid_cli.drive.signals import DriveSignals, beside_model, shifted
from seqid_cli.logs.raw import Rows
from seqid_cli.typing import Array, Mask

# One number, or an array of them.
Numbers: TypeAlias = "Array | float"
# Rows of a stretch of which a mean is taken: of fewer, all of them count.
FEWEST_ROWS = 10


@dataclass(frozen=True, kw_only=True)
class StretchMeans:
    """What integrals follow from at B rows, (B,) each.

    Attributes
    ----------
    summed : array
        rad s, the sum of the error at the row less its mean over the row's stretch.
    parts : mapping of str to array
        Means of what each part of the law multiplies, by the name of the part.
    torque : array
        N m, the mean of the measured torque, or of the model's.
    speed, acceleration, direction : array
        Means of the motion [rad/s, rad/s^2] and of the speed's sign, where a torque was
        not measured; else zero.
    """

    summed: Array
    parts: Mapping[str, Array]
    torque: Array
    speed: Array
    acceleration: Array
    direction: Array

    def integrals(
        self,
        gains: Mapping[str, Numbers],
        *,
        offset: Numbers,
        armature: Numbers,
        viscous: Numbers,
        coulomb: Numbers,
    ) -> Array:
        """Return the integral (S, B) or (B,) [rad s] at the rows.

        Parameters
        ----------
        gains : mapping of str to Numbers
            (S, 1), or one number, of every part in `parts` and of the integral.
        offset, armature, viscous, coulomb : Numbers
            (S, 1), or one number: what the law, and a torque that is the model's, have
            beside.
        """
        torque = self.torque + beside_model(
            self.speed,
            self.acceleration,
            self.direction,
            armature=armature,
            viscous=viscous,
            coulomb=coulomb,
        )
        for name, mean in self.parts.items():
            torque = torque - gains[name] * mean
        integral = gains[INTEGRAL]
        is_there = integral != 0.0
        begun = (torque - offset) / np.where(is_there, integral, 1.0)
        return np.where(is_there, self.summed + begun, 0.0)


def stretch_means(
    log: DriveSignals,
    joint: int,
    course: str,
    rows: Rows,
    names: Sequence[str],
    delays: Delays,
    *,
    torque_limit: float,
    dead_band: float = 0.0,
) -> StretchMeans:
    """Compute what integrals follow from at rows of a log.

    Parameters
    ----------
    log : DriveSignals
    joint : int
    course : str
        What commands do between two stamps.
    rows : (B,) array of int
    names : sequence of str
        Parts that the law has beside the integral.
    delays : Delays
    torque_limit : float
        N m; near it a controller does not go by its law.
    dead_band : float
        rad, of the error.
    """
    law = _law_of(log, joint, course, torque_limit)
    error = summed_error(law, log, delays.command, dead_band)
    columns = np.column_stack([_columns(law, log, names, delays), error])
    finite: Mask = np.asarray(np.isfinite(columns).all(axis=1))
    columns = np.nan_to_num(columns)

    lawful = stretches(law.lawful[0], log.rate_hz) or [np.arange(len(columns))]
    nearest = _nearest(lawful, rows)
    means = np.zeros((len(rows), columns.shape[1]))
    for k in np.unique(nearest):
        chosen = _telling(lawful[k], law.used[0], finite)
        means[nearest == k] = columns[chosen].mean(axis=0)
    torque, speed, acceleration, direction, summed = means[:, len(names) :].T
    return StretchMeans(
        summed=columns[rows, -1] - summed,
        parts=dict(zip(names, means.T, strict=False)),
        torque=torque,
        speed=speed,
        acceleration=acceleration,
        direction=direction,
    )


def _law_of(
    log: DriveSignals, joint: int, course: str, torque_limit: float
) -> JointLaw:
    """Return the law of a joint in a log, without rows near a limit of its torque."""
    law = JointLaw(
        logs=[log],
        joint=joint,
        course=course,
        used=[telling_rows(log, joint)],
        lawful=[log.usable[:, joint]],
    )
    if not np.isfinite(torque_limit):
        return law
    return replace(
        law,
        used=below(law, law.used, NEAR_LIMIT * torque_limit),
        lawful=below(law, law.lawful, NEAR_LIMIT * torque_limit),
    )


def _columns(
    law: JointLaw, log: DriveSignals, names: Sequence[str], delays: Delays
) -> Array:
    """Return what parts multiply, torque and motion of a log (N, p + 4)."""
    j = law.joint
    at_row = Delays(command=delays.command, torque=0.0)
    columns, torque = law.columns(log, names, at_row)
    motion = np.zeros((len(torque), 3))
    if log.measured:
        # The torque's channel shows it so much later.
        torque = shifted(torque, -delays.torque * log.rate_hz)
    else:
        motion = np.stack([log.dq[:, j], log.ddq[:, j], np.sign(log.dq[:, j])], axis=1)
    return np.column_stack([columns, torque, motion])


def _nearest(of_log: Sequence[Rows], rows: Rows) -> Rows:
    """Return the number (B,) of the stretch that holds each row, or is next to it."""
    away = [
        np.maximum(stretch[0] - rows, rows - stretch[-1]).clip(0) for stretch in of_log
    ]
    nearest: Rows = np.argmin(away, axis=0)
    return nearest


def _telling(stretch: Rows, used: Mask, finite: Mask) -> Rows:
    """Return the rows of a stretch of which means are taken."""
    for mask in (used & finite, finite):
        chosen = stretch[mask[stretch]]
        if len(chosen) >= FEWEST_ROWS:
            return chosen
    return stretch
