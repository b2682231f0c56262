"""The controller's law as linear equations, given its delays.

At time t the torque u that a controller of joint j asks for is

    u(t) = kp (c - q) - kd q' + kv c' + ka c'' + ki S(c - q) + kg g(q) + b,

the command c taken a delay d ago, S the integral over time, g the gravity torque of the
model, b an offset. The torque's channel is late by a lag l:

    tau(t) = u(t - l) = sum_k theta_k x_k(t; l, d) + e.

Where the model's torque stands for a measured one, l is 0.

Each log has an offset of its own. With an integral each stretch has one in which the
controller went by this law, for the integral begins anew behind it. Columns and torque
are freed of their means instead, stretch by stretch.

Commands that hold bend speeds between rows. By how much rows miss that is known, but
for a factor of each joint whose command steps (`bends`). Columns and
torque are freed of it as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.bends import delayed_bends
from seqid_cli.drive.signals import DriveSignals, delayed_command, delayed_sum, shifted
from seqid_cli.logs.raw import Rows
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.robust import rms
from seqid_cli.typing import Array, Mask

PROPORTIONAL = "proportional"
DERIVATIVE = "derivative"
VELOCITY_FEEDFORWARD = "velocity_feedforward"
ACCELERATION_FEEDFORWARD = "acceleration_feedforward"
INTEGRAL = "integral"
GRAVITY = "gravity_compensation"
# What a model may lack: the law explains its torque together with these.
ARMATURE = "armature"
COULOMB = "coulomb"
# Every part of a controller, in the order of documents.
PARTS = (
    PROPORTIONAL,
    DERIVATIVE,
    INTEGRAL,
    VELOCITY_FEEDFORWARD,
    ACCELERATION_FEEDFORWARD,
    GRAVITY,
)
UNITS = {
    PROPORTIONAL: "N m/rad",
    DERIVATIVE: "N m s/rad",
    INTEGRAL: "N m/(rad s)",
    VELOCITY_FEEDFORWARD: "N m s/rad",
    ACCELERATION_FEEDFORWARD: "N m s^2/rad",
    GRAVITY: "1",
}
# Of the RMS speed: slower rows are near a reversal, where friction is any torque.
SLOW = 0.2
# The shortest stretch with an offset of its own: of a shorter one nothing is left.
LEAST_STRETCH_S = 1.0
# Rows are taken so many times per period of the cut-off: others repeat them.
ROWS_PER_PERIOD = 6.0
# Of the square of a unit column, that belongs to no other: less is rounding.
SPANS = 1e-8
# Rows are off alike over so long at most [s], for errors.
ALIKE_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Delays:
    """Delays of one joint [s]."""

    command: float  # d
    torque: float  # l

    def moved(self, command: float = 0.0, torque: float = 0.0) -> "Delays":
        """Return delays that are longer by some time [s]."""
        return Delays(command=self.command + command, torque=self.torque + torque)


@dataclass(frozen=True, kw_only=True)
class Equations:
    """Rows of all logs for one joint, M of them, with p columns."""

    X: Array  # (M, p)
    y: Array  # (M,) N m
    at: Rows  # (M,) place of each row on a grid that goes through all logs
    rate_hz: float  # of that grid
    means: Array  # (p + 1,) of columns and torque, over all rows
    bends: Array  # (M, k) orthonormal, of which columns and torque are free

    def freed(self, values: Array) -> Array:
        """Return values (M, ...) of the rows without what bends explain."""
        return values - self.bends @ (self.bends.T @ values)


@dataclass(frozen=True, kw_only=True)
class JointLaw:
    """The logs of one joint, and which rows of them count."""

    logs: Sequence[DriveSignals]
    joint: int
    course: str  # "held" or "interpolated": what commands do between two stamps
    used: Sequence[Mask]  # (N,) of each log
    lawful: Sequence[Mask]  # (N,) of each log, where the controller goes by the law
    bends: bool = True  # whether what rows miss of speeds counts

    def equations(self, names: Sequence[str], delays: Delays) -> Equations:
        """Write the law as equations for the parts of some names."""
        parts = []
        first = 0
        rate_hz = self.logs[0].rate_hz / self._stride(self.logs[0])
        for log, used, lawful in zip(self.logs, self.used, self.lawful, strict=True):
            columns, y = self.columns(log, names, delays)
            columns = np.hstack([columns, self._bends(log, delays)])
            # A sum is not finite where one of its parts is not.
            keep = used & np.isfinite(columns @ np.ones(columns.shape[1]) + y)
            stride = self._stride(log)
            of_log = [np.flatnonzero(lawful)]
            if INTEGRAL in names:
                of_log = stretches(lawful, log.rate_hz)
            for stretch in of_log:
                rows = stretch[keep[stretch] & (stretch % stride == 0)]
                if len(rows) <= len(names) + 1:
                    continue
                parts.append((columns[rows], y[rows], first + rows // stride))
            first += len(y) // stride + int(ALIKE_S * rate_hz)
        if not parts:
            empty = np.zeros((0, len(names)))
            return Equations(
                X=empty,
                y=np.zeros(0),
                at=np.zeros(0, np.intp),
                rate_hz=rate_hz,
                means=np.zeros(len(names) + 1),
                bends=np.zeros((0, 0)),
            )
        X_all = np.concatenate([X for X, _, _ in parts])
        y_all = np.concatenate([y for _, y, _ in parts])
        X = np.concatenate([X - X.mean(axis=0) for X, _, _ in parts])
        y = np.concatenate([y - y.mean() for _, y, _ in parts])
        p = len(names)
        equations = Equations(
            X=X[:, :p],
            y=y,
            at=np.concatenate([at for _, _, at in parts]),
            rate_hz=rate_hz,
            means=np.append(X_all[:, :p].mean(axis=0), y_all.mean()),
            bends=_orthonormal(X[:, p:]),
        )
        if not equations.bends.shape[1]:
            return equations
        return replace(equations, X=equations.freed(X[:, :p]), y=equations.freed(y))

    def _bends(self, log: DriveSignals, delays: Delays) -> Array:
        """Return what rows miss of speeds (N, k), a column for each command."""
        if self.course != "held" or not log.measured or not self.bends:
            return np.zeros((len(log.q), 0))
        return delayed_bends(log, delays.torque, delays.torque + delays.command)

    def summed(
        self, log: DriveSignals, error: Array, lag: float, total: float
    ) -> Array:
        """Return the integral (N,) of the error [rad s]."""
        if self.course != "held":
            return _trapezoids(error) / log.rate_hz
        # Where a step comes between two rows counts here.
        command = delayed_sum(log, self.joint, total / log.rate_hz)
        q = shifted(log.q[:, self.joint], lag)
        return command - _trapezoids(q) / log.rate_hz

    @staticmethod
    def _stride(log: DriveSignals) -> int:
        """Return of how many rows one is taken."""
        return max(1, int(log.rate_hz / (ROWS_PER_PERIOD * log.cutoff_hz)))

    def columns(
        self, log: DriveSignals, names: Sequence[str], delays: Delays
    ) -> tuple[Array, Array]:
        """Return the columns (N, p) of a log, NaN where there is none, and torque."""
        j = self.joint
        lag = delays.torque * log.rate_hz
        total = lag + delays.command * log.rate_hz
        command = log.commands[self.course]
        delayed = delayed_command(log, self.course, j, total / log.rate_hz)
        error = delayed - shifted(log.q[:, j], lag)
        columns = {PROPORTIONAL: error}
        if INTEGRAL in names:
            columns[INTEGRAL] = self.summed(log, error, lag, total)
        if DERIVATIVE in names:
            columns[DERIVATIVE] = -shifted(log.dq[:, j], lag)
        if VELOCITY_FEEDFORWARD in names:
            columns[VELOCITY_FEEDFORWARD] = shifted(command.dc[:, j], total)
        if ACCELERATION_FEEDFORWARD in names:
            columns[ACCELERATION_FEEDFORWARD] = shifted(command.ddc[:, j], total)
        if GRAVITY in names:
            columns[GRAVITY] = shifted(log.gravity[:, j], lag)
        if ARMATURE in names:
            columns[ARMATURE] = -log.ddq[:, j]
        if COULOMB in names:
            columns[COULOMB] = -np.sign(log.dq[:, j])
        return np.stack([columns[name] for name in names], axis=1), log.torque[:, j]


def stretches(lawful: Mask, rate_hz: float) -> list[Rows]:
    """Return the rows of each stretch in which a controller goes by its law."""
    least = LEAST_STRETCH_S * rate_hz
    return [
        np.arange(start, stop)
        for start, stop in runs(lawful, len(lawful))
        if stop - start >= least
    ]


def telling_rows(log: DriveSignals, joint: int) -> Mask:
    """Return the samples of a log that tell the law of a joint."""
    used = log.usable[:, joint].copy()
    if not log.measured:
        # At rest friction is anything up to its limit.
        speed = np.abs(log.dq[:, joint])
        used &= log.moving[:, joint] & (speed > SLOW * rms(speed[used]))
    return used


def summed_error(
    law: JointLaw, log: DriveSignals, delay_s: float, dead_band: float
) -> Array:
    """Return the sum (N,) of a joint's error beyond a dead band, at rows [rad s]."""
    j = law.joint
    delayed = delayed_command(log, law.course, j, delay_s)
    error = delayed - log.q[:, j]
    if dead_band:
        error = error - np.clip(error, -dead_band, dead_band)
        return _trapezoids(error) / log.rate_hz
    return law.summed(log, error, 0.0, delay_s * log.rate_hz)


def _orthonormal(columns: Array) -> Array:
    """Return a basis (M, r) of what some columns (M, k) span."""
    scale = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(scale > 0.0, scale, 1.0)
    squares, axes = np.linalg.eigh(unit.T @ unit)
    spans = squares > SPANS
    return np.asarray(unit @ (axes[:, spans] / np.sqrt(squares[spans])))


def _trapezoids(values: Array) -> Array:
    """Return the sum (N,) of values up to each, half of itself, from what is there."""
    summed = np.cumsum(np.where(np.isfinite(values), values, 0.0))
    return np.asarray(summed - 0.5 * values)


def own_shares(X: Array) -> Array:
    """Return the share (p,) of each column's length that no other column explains."""
    lengths = np.linalg.norm(X, axis=0)
    scaled = X / np.where(lengths > 0.0, lengths, 1.0)
    shares = np.zeros(X.shape[1])
    for k in range(X.shape[1]):
        if not lengths[k] > 0.0:
            continue
        others = np.delete(scaled, k, axis=1)
        if not others.shape[1]:
            shares[k] = 1.0
            continue
        fit = np.linalg.lstsq(others, scaled[:, k], rcond=1e-12)[0]
        shares[k] = np.linalg.norm(scaled[:, k] - others @ fit)
    return shares
