"""The standard deviation of a predicted torque, for any motion.

With the calibration in the parameter file it is

    std = factor(speed, load) * sqrt(p + e + left_std^2).

p is the variance by the errors of the parameters (`variance`), e the one by the errors
of the effects' coefficients. Both grow where a motion depends on parameters that the
logs hardly determine, and p grows beyond the speeds at which friction was identified.
White noise grows with the cut-off, so `left_std` is widened where a log is filtered at
a higher cut-off than the calibration.

A file without a calibration states the residual of its stage alone. Bands then suit
normal errors of that size, which is too narrow for logs of another day.
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

# Samples per period of the cut-off at which variances are computed. They are smooth, so
# that all others are interpolated.
NODES_PER_CUTOFF = 8.0


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Standard deviations of a log's predicted torques at N samples of n joints.

    Attributes
    ----------
    std : array (N, n)
        Standard deviation with the noise [N m]; NaN for a joint without any statement.
    parameter_std : array (N, n)
        The part by errors of parameters and effects [N m].
    fast, loaded : array (N, n) or None
        Whether a sample is beyond the calibration's edge of speed, and of load; None
        where the file has no calibration.
    """

    std: Array
    parameter_std: Array
    fast: Mask | None = None
    loaded: Mask | None = None


@dataclass(frozen=True, kw_only=True)
class Bands:
    """Statements of a parameter file on the errors of its predictions.

    `residual_std` (n,) N m is the residual of the stages, NaN where no stage states
    one. It is used for joints without a calibration.
    """

    robot: Robot
    stages: Stages
    variance: ParameterVariance
    calibration: BandCalibration | None
    residual_std: Array

    @classmethod
    def from_stages(cls, stages: Stages, robot: Robot) -> "Bands":
        """Use the calibration of the inertia stage, else the stages' residuals."""
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
        """Return the deviation of the torque predicted for a motion.

        Parameters
        ----------
        motion : Motion
            N samples of the joint motion.
        effects_variance : array (N, n), optional
            Variance by the errors of the effects' coefficients [(N m)^2].

        Returns
        -------
        Deviation
            Standard deviations (N, n) [N m].
        """
        nodes = _nodes(motion)
        q = motion.q[nodes]
        dq = motion.dq[nodes]
        ddq = motion.ddq[nodes]
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
            parameter_variance = _between(variance[:, j], nodes, motion.samples)
            parameter_std[:, j] = np.sqrt(parameter_variance)
            band = self.joint(name)
            if band is None or self.calibration is None:
                residual_variance = self.residual_std[j] ** 2
                std[:, j] = np.sqrt(parameter_variance + residual_variance)
                continue

            fast[:, j] = np.abs(motion.dq[:, j]) >= band.speed_edge
            joint_load = _between(load[:, j], nodes, motion.samples)
            loaded[:, j] = joint_load >= band.load_edge
            factors = np.array([cell.factor for cell in band.cells])
            factor = factors[cell_of(fast[:, j], loaded[:, j])]

            # The variance of white noise is proportional to the cut-off.
            noise_ratio = max(1.0, cutoff_hz / max(self.calibration.cutoff_hz, 1e-12))
            noise_variance = noise_ratio * band.left_std**2
            std[:, j] = factor * np.sqrt(parameter_variance + noise_variance)

        if self.calibration is None:
            return Deviation(std=std, parameter_std=parameter_std)
        return Deviation(std=std, parameter_std=parameter_std, fast=fast, loaded=loaded)

    def notes(
        self, cutoffs_hz: Sequence[float] = (), *, higher: float = 1.1
    ) -> list[str]:
        """Return notes on bands that rest on an assumption instead of a calibration.

        Parameters
        ----------
        cutoffs_hz : sequence of float
            Cut-offs of the predicted logs [Hz].
        higher : float
            Ratio of a log's cut-off to the calibration's from which there is a note.
        """
        notes = []
        names = self.robot.joint_names
        missing = [name for name in names if self.joint(name) is None]
        # Without an inertia stage the prediction has a note on that already.
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
    """Return the RMS residual (n,) N m of each joint's torque by its last stage.

    It is NaN for a joint of which no stage states a residual.
    """
    friction = stages.friction.joints if stages.friction is not None else {}
    residual_std = np.full(robot.n, np.nan)
    for j, name in enumerate(robot.joint_names):
        if name in friction:
            residual_std[j] = friction[name].rmse
        for stage in (stages.gravity, stages.inertia):
            if stage is not None and name in stage.rmse:
                residual_std[j] = stage.rmse[name]
    return residual_std


def _nodes(motion: Motion) -> Index:
    """Return the samples at which variances are computed.

    They lie on a grid of the log's time, so that a part of a log has the nodes of the
    whole log. The first and the last sample are always among them.
    """
    stride = 1
    if motion.lowpass.active:
        node_rate_hz = NODES_PER_CUTOFF * motion.lowpass.cutoff_hz
        stride = max(1, int(motion.rate_hz / node_rate_hz))
    samples_before = round(float(motion.t[0]) * motion.rate_hz)
    on_grid = np.arange(-samples_before % stride, motion.samples, stride)
    return np.unique(np.concatenate(([0], on_grid, [motion.samples - 1])))


def _between(values: Array, nodes: Index, samples: int) -> Array:
    """Interpolate values at the nodes linearly to all samples."""
    if len(nodes) == samples:
        return values
    return np.asarray(np.interp(np.arange(samples), nodes, values))
