"""Torque predicted by an identified model, log by log.

A long log is passed over part by part, at its own rate.
"""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from seqid_cli.effects.apply import added_torque, effects_variance, scene_of_log
from seqid_cli.effects.fitted import Fitted, fitted_effects
from seqid_cli.identify.bands.prediction import Bands, Deviation
from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.noise_level import PASSED
from seqid_cli.logs import long as long_logs
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.long import LongLog
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.model.friction import slowest_speeds
from seqid_cli.model.torque import Predicted, TorqueModel, outside_of, sliding
from seqid_cli.motion.blocks import Plan, motion_blocks, overlapping
from seqid_cli.motion.motion import Motion, too_short
from seqid_cli.params.schema import MotionUse, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

# Share of samples outside the identified friction from which there is a note.
OUTSIDE_NOTE = 0.01


@dataclass(frozen=True, kw_only=True)
class LogPrediction:
    """Measured and predicted torque of one log, or of a part of a long log.

    Both torques pass the same low-pass. The parts of a long log follow one another, and
    only the last part has notes and the use of its motion.

    Attributes
    ----------
    path : Path
        The log.
    sha256 : str
        Checksum of the log.
    samples : int
        Number of samples of the whole log.
    cutoff_hz : float
        Cut-off of the low-pass [Hz].
    t : array (N,)
        Time within the log [s].
    tau, predicted : array (N, n)
        Measured torque, and the model's own value whatever was measured [N m].
    low, high : array (N, n)
        Bounds of the torques that the model allows [N m]. Friction is an interval
        unless the joint certainly slides; where it slides both are `predicted`.
    used : array (N,)
        Samples that count, away from ends and gaps.
    sliding : array (N, n)
        Used samples at which a joint certainly slides.
    q, dq, ddq : array (N, n)
        Joint positions [rad], speeds [rad/s] and accelerations [rad/s^2] (m for
        prismatic joints).
    outside : array (N, n)
        Sliding samples beyond the identified friction.
    std : array (N, n)
        Standard deviation of the prediction, with the noise [N m]: of `predicted` where
        a joint slides, else of both bounds. NaN where the file states none.
    parameter_std : array (N, n)
        The part of `std` by errors of parameters and effects [N m].
    fast, loaded : array (N, n) or None
        Whether a sample is beyond the edges of speed and load of the bands'
        calibration; None without a calibration.
    notes : tuple of str
        What the prediction lacks.
    motion : MotionUse or None
        The sensors that the motion is from.
    start : float
        First sample of the log on its own clock [s].
    part : int
        Number of this part of the log, from 0.
    last : bool
        Whether this is the last part of the log.
    """

    path: Path
    sha256: str
    samples: int
    cutoff_hz: float
    t: Array
    tau: Array
    predicted: Array
    low: Array
    high: Array
    used: Mask
    sliding: Mask
    q: Array
    dq: Array
    ddq: Array
    outside: Mask
    std: Array
    parameter_std: Array
    fast: Mask | None = None
    loaded: Mask | None = None
    notes: tuple[str, ...] = ()
    motion: MotionUse | None = None
    start: float = 0.0
    part: int = 0
    last: bool = True

    @property
    def residual(self) -> Array:
        """The measured minus the predicted torque (N, n) N m."""
        return self.tau - self.predicted

    @property
    def beyond(self) -> Array:
        """The measured torque minus the nearest allowed torque (N, n) N m."""
        return self.tau - np.clip(self.tau, self.low, self.high)


def slides_from(model: TorqueModel, options: InertiaOptions) -> Array:
    """Return the speeds from which the joints certainly slide.

    Parameters
    ----------
    model : TorqueModel
        The model, whose friction decides unless the options do.
    options : InertiaOptions
        Options of the prediction.

    Returns
    -------
    array (n,)
        Speeds [rad/s] (m/s for prismatic joints).
    """
    if options.slides_from is None:
        return slowest_speeds(model.surfaces)
    return np.array(options.slides_from)


def predict(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    unexplained: bool = False,
    sliding_only: bool = False,
) -> Iterator[LogPrediction]:
    """Predict the torque of logs, with the effects that the parameter file names.

    What has not been identified is taken as zero and noted.

    Parameters
    ----------
    recordings : iterable of Recording
        The logs.
    robot : Robot
        The robot.
    stages : Stages
        The model.
    options : InertiaOptions
        Options of the motion, the torque's source and the speeds of sliding.
    unexplained : bool
        Whether smooth terms of no known cause count as well.
    sliding_only : bool
        Whether only samples count at which a joint slides. This saves the intervals at
        rest, the friction of joints that stay there, the deviations, and the note on
        the encoders.

    Yields
    ------
    LogPrediction
        One per log; the parts of a long log one after the other.

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    ConfigError
        If this version does not know an effect, or the effect is not valid.
    """
    model = TorqueModel.from_stages(stages, robot)
    effects = tuple(fitted_effects(stages, robot, unexplained=unexplained))
    bands = None if sliding_only else Bands.from_stages(stages, robot)
    predictor = Predictor(
        model=model,
        stages=stages,
        options=options,
        effects=effects,
        sliding_only=sliding_only,
        bands=bands,
    )

    can_stream = equations.streams(stages, options) and local_effects(model, effects)
    pass_over_from = long_logs.LONG if can_stream else None
    for parts in mapped(recordings, predictor, pass_over_from):
        yield from parts


def local_effects(model: TorqueModel, effects: Sequence[Fitted]) -> bool:
    """Return whether parts of a log give the same effects as the whole log."""
    # Effects also depend on the speed over which the direction of motion changes.
    # Without friction in the file it would come from the log, and differ by part.
    has_all_friction = all(surface is not None for surface in model.surfaces)
    if not effects:
        return True
    return has_all_friction and all(effect.local for effect in effects)


@dataclass(frozen=True, kw_only=True)
class Predictor:
    """Predictor of one log, or of the parts of a long log as they are iterated over."""

    model: TorqueModel
    stages: Stages
    options: InertiaOptions
    effects: Sequence[Fitted] = ()
    sliding_only: bool = False
    bands: Bands | None = None  # None: without standard deviations

    def __call__(self, log: Recording | LongLog, _: int) -> Iterable[LogPrediction]:
        """Predict a log; its number among the logs does not matter."""
        robot = self.model.robot
        # Every sample is predicted, while the equations of a stage are thinned.
        options = replace(self.options.motion, samples_per_cutoff=float("inf"))
        if isinstance(log, LongLog):
            plan = equations.plan_of(log, robot, options)
            return LongPrediction(log, log.sha256, plan, self)

        motion = equations.torque_motion(
            log, robot, options, imu=self.stages.imu, source=self.options.source
        )
        part = self.part(motion, log, slice(None))
        notes_on_noise: tuple[str, ...] = ()
        if not self.sliding_only:
            notes_on_noise = tuple(encoder_notes(self.model, motion, part))
        return [
            replace(prediction, notes=(*prediction.notes, *notes_on_noise))
            for prediction in self.described([(part, motion)])
        ]

    def part(self, motion: Motion, log: Recording, inner: slice) -> LogPrediction:
        """Predict the inner samples of a motion.

        Parameters
        ----------
        motion : Motion
            The inner samples and those around them, so that filters have settled.
        log : Recording
            The log of the motion.
        inner : slice
            Samples to return.
        """
        model = self.model
        slowest = slides_from(model, self.options)
        ranges = self.options.identified_ranges or model.identified_ranges
        is_sliding = sliding(motion, slowest)

        torque_of_effects = None
        variance_of_effects = None
        if self.effects:
            scene = scene_of_log(log, model.robot, model, motion)
            torque_of_effects = added_torque(scene, log, self.effects, slowest)
            if self.bands is not None:
                variance_of_effects = effects_variance(scene, log, self.effects)

        not_stated = np.full(motion.q.shape, np.nan)
        deviation = Deviation(std=not_stated, parameter_std=not_stated)
        if self.bands is not None:
            deviation = self.bands.of(motion, variance_of_effects)

        if self.sliding_only:
            # Friction of a joint that never slides here is computed for nothing.
            surfaces = [
                surface if is_sliding[:, j].any() else None
                for j, surface in enumerate(model.surfaces)
            ]
            model = replace(model, surfaces=surfaces)
            value = model.predict(motion)
            if torque_of_effects is not None:
                value = value + torque_of_effects.value
            allowed = Predicted(value=value, low=value, high=value)
        else:
            allowed = model.predict_set(motion, is_sliding, torque_of_effects)

        inner_motion = motion.part(inner)
        assert inner_motion.tau is not None
        return LogPrediction(
            path=log.path,
            sha256=log.sha256,
            samples=motion.samples,
            cutoff_hz=motion.cutoff.hz,
            t=inner_motion.t,
            tau=inner_motion.tau,
            predicted=allowed.value[inner],
            low=allowed.low[inner],
            high=allowed.high[inner],
            used=inner_motion.usable,
            sliding=is_sliding[inner],
            q=inner_motion.q,
            dq=inner_motion.dq,
            ddq=inner_motion.ddq,
            start=log.start,
            outside=outside_of(ranges, inner_motion) & is_sliding[inner],
            std=deviation.std[inner],
            parameter_std=deviation.parameter_std[inner],
            fast=None if deviation.fast is None else deviation.fast[inner],
            loaded=None if deviation.loaded is None else deviation.loaded[inner],
        )

    def described(
        self, parts: Iterable[tuple[LogPrediction, Motion]]
    ) -> Iterator[LogPrediction]:
        """Yield the parts of a log, the last with notes and the use of its motion."""
        robot = self.model.robot
        slowest_trial = np.zeros(robot.n)  # of each joint's friction, rad/s
        for j, surface in enumerate(self.model.surfaces):
            if surface is not None:
                slowest_trial[j] = surface.scaling.speed[0]

        n_sliding = np.zeros(robot.n)
        n_outside = np.zeros(robot.n)
        n_slower = np.zeros(robot.n)
        is_moving = np.zeros(robot.n, dtype=bool)
        is_used = False
        for part, motion in parts:
            is_slower = part.outside & (np.abs(part.dq) < slowest_trial)
            n_sliding += part.sliding.sum(axis=0)
            n_outside += part.outside.sum(axis=0)
            n_slower += is_slower.sum(axis=0)
            is_moving |= motion.moving.any(axis=0)
            is_used |= bool(part.used.any())
            if not part.last:
                yield part
                continue

            if not is_used:
                raise too_short(part.path, part.cutoff_hz)
            outside = n_outside / np.maximum(n_sliding, 1.0)
            slower = n_slower / np.maximum(n_sliding, 1.0)
            notes = tuple(notes_on(self.model, self.stages, outside, slower))
            motion_of_log = replace(motion, moving=is_moving[None])
            use = equations.motion_use(part.path, robot, motion_of_log)
            yield replace(part, notes=notes, motion=use)


@dataclass(frozen=True)
class LongPrediction:
    """An opened long log and its filters; iterating predicts it part by part."""

    rows: ClassVar[int] = 32_768  # samples of a part, and twice the margin at least

    log: LongLog
    sha256: str  # the local copy of a remote log is gone when the parts are asked for
    plan: Plan
    predictor: Predictor

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the temporary file of this process."""
        return {**self.__dict__, "log": replace(self.log, spool=None)}

    def __iter__(self) -> Iterator[LogPrediction]:
        return self.predictor.described(self._parts())

    def _parts(self) -> Iterator[tuple[LogPrediction, Motion]]:
        """Yield the parts with their motion."""
        log = self.log
        lowpass = self.plan.lowpass
        # With this margin beside a part, filters forget the samples beyond it. Parts
        # then give the same torque as the whole log.
        margin = 2 * (lowpass.memory + lowpass.settling)
        with contextlib.ExitStack() as stack:
            if log.spool is None:
                copy = stack.enter_context(local_copy(log.path))
                if copy is not log.path:
                    reading = log.file.reading
                    log = replace(log, file=LogFile.at(copy, reading=reading))

            motions = motion_blocks(log.blocks(), self.plan)
            pieces = overlapping(motions, max(self.rows, 2 * margin), margin)
            for number, (motion, start, stop) in enumerate(pieces):
                recording = Recording(
                    path=log.path,
                    sha256=self.sha256,
                    format=log.format,
                    t=motion.t,
                    q=motion.q,
                    valid=motion.valid,
                    health=Health(log.rate_hz, log.base.jitter),
                    start=log.start,
                )
                part = self.predictor.part(motion, recording, slice(start, stop))
                is_last = bool(part.t[-1] * log.rate_hz > log.samples - 1.5)
                part = replace(part, samples=log.samples, part=number, last=is_last)
                yield part, motion


def encoder_notes(
    model: TorqueModel,
    motion: Motion,
    of: LogPrediction,
    *,
    min_share: float = 0.5,
    places: int = 50,
) -> Iterator[str]:
    """Yield a note on joints whose error is mostly noise of the encoders.

    Parameters
    ----------
    model : TorqueModel
        The model.
    motion : Motion
        Motion of the log.
    of : LogPrediction
        Prediction of the log.
    min_share : float
        Share of the squared error from which noise deserves the note.
    places : int
        Number of samples of the log at which the torque by noise is computed.
    """
    if motion.source != "encoder" or not motion.cutoff.above_own:
        return

    # An error of the acceleration makes the torque M(q) ddq: one joint at a time.
    q = motion.q[:: max(1, motion.samples // places)]
    zeros = np.zeros_like(q)
    torque_at_rest = model.rigid(q, zeros, zeros)
    noise_square = np.zeros_like(q)
    for j, error in enumerate(motion.acceleration_error):
        ddq = zeros.copy()
        ddq[:, j] = error
        noise_square += (model.rigid(q, zeros, ddq) - torque_at_rest) ** 2
    noise_rms = PASSED * np.sqrt(noise_square.mean(axis=0))

    n_sliding = np.maximum(of.sliding.sum(axis=0), 1)
    residual_square = np.where(of.sliding, of.residual, 0.0) ** 2
    rmse = np.sqrt(np.sum(residual_square, axis=0) / n_sliding)

    noisy_joints = []
    for j, joint in enumerate(model.robot.joints):
        if noise_rms[j] ** 2 > min_share * rmse[j] ** 2 > 0.0:
            noisy_joints.append(f"{joint.name} ({rmse[j]:.2g} {joint.unit('N m')})")
    if noisy_joints:
        yield (
            f"at {motion.cutoff.hz:.3g} Hz noise of the encoders makes the error of "
            f"{', '.join(noisy_joints)}, for which no model is to blame: "
            f"--cutoff {motion.cutoff.alone_hz:.3g} suits them"
        )


def notes_on(
    model: TorqueModel, stages: Stages, outside: Array, slower: Array
) -> Iterator[str]:
    """Yield notes on what a prediction lacks.

    Parameters
    ----------
    model : TorqueModel
        The model.
    stages : Stages
        Stages of the model.
    outside, slower : array (n,)
        Shares of each joint's sliding samples outside the identified friction, and of
        those slower than the trials of friction.
    """
    names = model.robot.joint_names
    if stages.inertia is None:
        yield "no inertia stage in the parameter file: inertial torque is taken as zero"

    without_friction = [
        name
        for name, surface in zip(names, model.surfaces, strict=True)
        if surface is None
    ]
    if without_friction:
        missing = ", ".join(without_friction)
        yield f"no friction in the parameter file, taken as zero: {missing}"

    extrapolated = []
    for name, outside_share, slower_share in zip(names, outside, slower, strict=True):
        if not outside_share > OUTSIDE_NOTE:
            continue
        text = f"{name} {percent(outside_share, 0)}"
        if 2.0 * slower_share > outside_share:
            text += " (slower than its trials)"
        extrapolated.append(text)
    if extrapolated:
        yield (
            "outside the speeds or positions at which friction was identified, so that"
            f" it is extrapolated: {', '.join(extrapolated)} of the samples"
        )
