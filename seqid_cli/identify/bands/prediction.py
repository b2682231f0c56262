"""The standard deviation of a predicted torque, for any motion.

By the calibration of the parameter file it is

    std = factor(speed, load) * sqrt(p + e + left_std^2),

p the variance by the errors of the parameters (`variance`), e by those of the
coefficients of the effects. Both grow where a motion asks for what the logs have hardly
shown; beyond the identified friction p grows by what is not known there. White noise
grows with the cut-off, so `left_std` does as well where a log is filtered at a higher
one than the calibration's.

A file without a calibration has the residual of its stage alone. Bands are then as wide
as normal errors of that size would ask for, which is too narrow for logs of another
day.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.bands.calibrate import cell_of, load_of
from seqid_cli.identify.bands.variance import ParameterVariance
from seqid_cli.motion.motion import Motion
from seqid_cli.params.bands_schema import BandCalibration, JointBand
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

# Samples per period of the cut-off at which variances are computed; between them they
# are smooth.
NODES_PER_CUTOFF = 8.0


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Standard deviations `std` (N, n) N m of a log's predicted torques, the noise included.

    `parameter_std` (N, n) N m is the part that errors of parameters and effects make.
    `fast` and `loaded` (N, n) say on which side of the calibration's edges a sample is;
    None where the file has no calibration. A joint of which nothing is known has NaN.
    """

    std: Array
    parameter_std: Array
    fast: Mask | None = None
    loaded: Mask | None = None


@dataclass(frozen=True, kw_only=True)
class Bands:
    """What a parameter file says of the errors of its predictions.

    `residual_std` (n,) N m is what stages left of the torque, NaN where none says so;
    it counts for joints without a calibration.
    """

    robot: Robot
    stages: Stages
    variance: ParameterVariance
    calibration: BandCalibration | None
    residual_std: Array

    @classmethod
    def from_stages(cls, stages: Stages, robot: Robot) -> "Bands":
        """Use the calibration of the inertia stage, else what the stages left."""
        inertia = stages.inertia
        return cls(
            robot=robot,
            stages=stages,
            variance=ParameterVariance.from_stages(stages, robot),
            calibration=None if inertia is None else inertia.bands,
            residual_std=_residual_std(stages, robot),
        )

    def joint(self, name: str) -> JointBand | None:
        """Return the calibration of a joint, if there is one."""
        return None if self.calibration is None else self.calibration.joints.get(name)

    def of(self, motion: Motion, effects_variance: Array | None = None) -> Deviation:
        """Return the deviation of the torque predicted for a motion of N samples.

        `effects_variance` (N, n) (N m)^2 is the variance by the errors of effects.
        """
        nodes = _nodes(motion)
        q, dq, ddq = motion.q[nodes], motion.dq[nodes], motion.ddq[nodes]
        variance = self.variance.of(q, dq, ddq)
        load = load_of(self.robot, self.stages, q, dq, ddq)
        if effects_variance is not None:
            variance = variance + effects_variance[nodes]

        cutoff_hz = motion.lowpass.cutoff_hz
        std = np.full(motion.q.shape, np.nan)
        parameter_std = np.zeros(motion.q.shape)
        fast = np.zeros(motion.q.shape, dtype=bool)
        loaded = np.zeros(motion.q.shape, dtype=bool)
        for j, name in enumerate(self.robot.joint_names):
            parameters = _between(variance[:, j], nodes, motion.samples)
            parameter_std[:, j] = np.sqrt(parameters)
            band = self.joint(name)
            if band is None or self.calibration is None:
                std[:, j] = np.sqrt(parameters + self.residual_std[j] ** 2)
                continue
            noise_ratio = max(1.0, cutoff_hz / max(self.calibration.cutoff_hz, 1e-12))
            fast[:, j] = np.abs(motion.dq[:, j]) >= band.speed_edge
            loaded[:, j] = _between(load[:, j], nodes, motion.samples) >= band.load_edge
            factors = np.array([cell.factor for cell in band.cells])
            factor = factors[cell_of(fast[:, j], loaded[:, j])]
            std[:, j] = factor * np.sqrt(parameters + noise_ratio * band.left_std**2)
        if self.calibration is None:
            return Deviation(std=std, parameter_std=parameter_std)
        return Deviation(std=std, parameter_std=parameter_std, fast=fast, loaded=loaded)

    def notes(
        self, cutoffs_hz: Sequence[float] = (), *, higher: float = 1.1
    ) -> list[str]:
        """Say where bands rest on an assumption instead of a calibration.

        `higher`: times the calibration's cut-off, from which that of a log is told.
        """
        notes = []
        names = self.robot.joint_names
        missing = [name for name in names if self.joint(name) is None]
        # Where an earlier stage is predicted with, the missing inertia stage is told
        # already.
        if missing and self.stages.inertia is not None:
            which = "" if len(missing) == len(names) else f" of {', '.join(missing)}"
            notes.append(
                f"bands{which} are not calibrated: the file has no errors of left-out"
                " logs, normal ones of its residual's size are taken; identify it"
                " again for bands that hold"
            )
        if self.calibration is not None and cutoffs_hz:
            calibrated_hz = self.calibration.cutoff_hz
            highest = max(cutoffs_hz)
            if highest > higher * calibrated_hz:
                notes.append(
                    f"bands were calibrated at a cut-off of {calibrated_hz:.3g} Hz and"
                    f" are widened for {highest:.3g} Hz as white noise asks for"
                )
        return notes


def _residual_std(stages: Stages, robot: Robot) -> Array:
    """Return what the last stage that says so left of each joint's torque (n,) N m, else NaN."""
    friction = stages.friction.joints if stages.friction is not None else {}
    found = np.full(robot.n, np.nan)
    for j, name in enumerate(robot.joint_names):
        if name in friction:
            found[j] = friction[name].rmse
        for stage in (stages.gravity, stages.inertia):
            if stage is not None and name in stage.rmse:
                found[j] = stage.rmse[name]
    return found


def _nodes(motion: Motion) -> Index:
    """Return the samples at which variances are computed, the first and the last among them.

    They lie on a grid of the log's time, so that a part of a log has those of the
    whole.
    """
    stride = 1
    if motion.lowpass.active:
        stride = max(
            1, int(motion.rate_hz / (NODES_PER_CUTOFF * motion.lowpass.cutoff_hz))
        )
    samples_before = round(float(motion.t[0]) * motion.rate_hz)
    on_grid = np.arange(-samples_before % stride, motion.samples, stride)
    return np.unique(np.concatenate(([0], on_grid, [motion.samples - 1])))


def _between(values: Array, nodes: Index, samples: int) -> Array:
    """Interpolate values at `nodes` linearly to all samples."""
    if len(nodes) == samples:
        return values
    return np.asarray(np.interp(np.arange(samples), nodes, values))
