"""Torque predicted by an identified model, log by log, a long one part by part at its own rate."""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from seqid_cli.identify.bands.prediction import Bands, Deviation
from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.equations import open_if_long
from seqid_cli.identify.regression.noise_level import PASSED
from seqid_cli.identify.rigid.inertia_equations import slowest_speeds
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.model.effects.apply import added_torque, effects_variance, scene_of_log
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.torque import Predicted, TorqueModel, sliding
from seqid_cli.motion.blocks import Plan, SurveyedLog, motion_blocks, overlapping
from seqid_cli.motion.motion import Motion, too_short
from seqid_cli.params.schema import MotionUse, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

OUTSIDE_NOTE = 0.01  # share of samples outside the identified friction worth a note


@dataclass(frozen=True)
class LogPrediction:
    """Measured and predicted torque (N, n) N m of one log, both low-passed alike.

    `predicted` is the model's own value, whatever was measured. `used` (N,) marks the
    samples that count, away from ends and gaps; `sliding` (N, n) those of them at which
    a joint certainly slides. Elsewhere friction is known only as an interval, and the
    model allows torques between `low` and `high` (N, n) N m; where the joint slides
    these are `predicted`. `q`, `dq`, `ddq` (N, n) are the joint motion behind the
    prediction, `start` [s] is the first sample of the log on its own clock. `outside`
    (N, n) marks sliding samples beyond the identified friction. `std` (N, n) N m is the
    standard deviation of the prediction with the noise: of `predicted` where a joint
    slides, at rest of both bounds; NaN where nothing says it. `parameter_std` (N, n) N
    m is the part of it that errors of parameters and effects make. `fast` and `loaded`
    (N, n) tell samples apart as the calibration of the bands does; None without one.

    A long log comes in several parts, one behind the other: `samples` are those of the
    whole log, `part` counts its parts from 0, and only the `last` one has `notes` and
    `motion`.
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
        """Measured minus predicted torque (N, n) N m."""
        return self.tau - self.predicted

    @property
    def beyond(self) -> Array:
        """Measured torque minus the nearest that the model allows (N, n) N m."""
        return self.tau - np.clip(self.tau, self.low, self.high)


def slides_from(model: TorqueModel, options: InertiaOptions) -> Array:
    """Speeds (n,) rad/s (m/s where prismatic) from which joints certainly slide."""
    own = options.slides_from
    return slowest_speeds(model.surfaces) if own is None else np.array(own)


def predict(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    unexplained: bool = False,
    sliding_only: bool = False,
) -> Iterator[LogPrediction]:
    """Predict the torque of any logs, with the effects that the parameter file names.

    What has not been identified is taken as zero and noted. `unexplained`: whether
    smooth terms of no known cause count as well. `sliding_only`: whether only samples
    count at which a joint slides: no interval is worked out at rest, no friction of a
    joint that stays there, and no note on the encoders. Yields one per log; of a long
    one that is passed over, its parts one after the other. Raises InputError if a log
    carries neither torque nor current, ConfigError if an effect is not known to this
    version, or is not what it should be.
    """
    model = TorqueModel.from_stages(stages, robot)
    effects = tuple(fitted_effects(stages, robot, unexplained=unexplained))
    long = equations.streams(stages, options) and local_effects(model, effects)
    bands = None if sliding_only else Bands.from_stages(stages, robot)
    one = Predictor(model, stages, options, effects, sliding_only, bands)
    for found in mapped(recordings, one, open_if_long if long else None):
        yield from found


def local_effects(model: TorqueModel, effects: Sequence[Fitted]) -> bool:
    """Whether effects can be predicted part by part, as they come out of the whole log."""
    # The speed over which the direction of motion changes must be known beforehand as
    # well.
    known = all(surface is not None for surface in model.surfaces)
    return not effects or (known and all(effect.local for effect in effects))


@dataclass(frozen=True)
class Predictor:
    """Predicts one log; parts of a long one, whose effects are local, as they are asked for."""

    model: TorqueModel
    stages: Stages
    options: InertiaOptions
    effects: Sequence[Fitted] = ()
    sliding_only: bool = False
    bands: Bands | None = None  # None: deviations are not asked for

    def __call__(self, log: Recording | SurveyedLog, _: int) -> Iterable[LogPrediction]:
        """Predict a log, by whatever number."""
        robot = self.model.robot
        every = replace(self.options.motion, samples_per_cutoff=float("inf"))
        if isinstance(log, SurveyedLog):
            plan = equations.plan_of(log, robot, every)
            return LongPrediction(replace(log, survey=None), plan, self)
        imu, source = self.stages.imu, self.options.source
        motion = equations.torque_motion(log, robot, every, imu=imu, source=source)
        part = self.part(motion, log, slice(None))
        noise = (
            () if self.sliding_only else tuple(encoder_notes(self.model, motion, part))
        )
        return [
            replace(x, notes=(*x.notes, *noise))
            for x in self.described([(part, motion)])
        ]

    def part(self, motion: Motion, log: Recording, inner: slice) -> LogPrediction:
        """Predict the inner samples of a motion."""
        model, slowest = self.model, slides_from(self.model, self.options)
        slides, added = sliding(motion, slowest), None
        unknown = np.full(motion.q.shape, np.nan)
        deviation = Deviation(std=unknown, parameter_std=unknown)
        by_effects = None
        if self.effects:
            scene = scene_of_log(log, model.robot, model, motion)
            added = added_torque(scene, log, self.effects, slowest)
            if self.bands is not None:
                by_effects = effects_variance(scene, log, self.effects)
        if self.bands is not None:
            deviation = self.bands.of(motion, by_effects)
        if self.sliding_only:
            known = [
                own if slides[:, j].any() else None
                for j, own in enumerate(model.surfaces)
            ]
            model = replace(model, surfaces=known)
            value = model.predict(motion) + (0.0 if added is None else added.value)
            allowed = Predicted(value, value, value)
        else:
            allowed = model.predict_set(motion, slides, added)
        own = motion.part(inner)
        assert own.tau is not None
        return LogPrediction(
            path=log.path,
            sha256=log.sha256,
            samples=motion.samples,
            cutoff_hz=motion.cutoff.hz,
            t=own.t,
            tau=own.tau,
            predicted=allowed.value[inner],
            low=allowed.low[inner],
            high=allowed.high[inner],
            used=own.usable,
            sliding=slides[inner],
            q=own.q,
            dq=own.dq,
            ddq=own.ddq,
            start=log.start,
            outside=model.outside(own) & slides[inner],
            std=deviation.std[inner],
            parameter_std=deviation.parameter_std[inner],
            fast=None if deviation.fast is None else deviation.fast[inner],
            loaded=None if deviation.loaded is None else deviation.loaded[inner],
        )

    def described(
        self, parts: Iterable[tuple[LogPrediction, Motion]]
    ) -> Iterator[LogPrediction]:
        """The parts of a log, the last with its notes and where its motion is from."""
        surfaces, robot = self.model.surfaces, self.model.robot
        slowest = np.array(
            [0.0 if own is None else own.scaling.speed[0] for own in surfaces]
        )
        counts, moving, used = (
            np.zeros((3, robot.n)),
            np.zeros(robot.n, dtype=bool),
            False,
        )
        for part, motion in parts:
            slower = part.outside & (np.abs(part.dq) < slowest)
            counts += [
                mask.sum(axis=0) for mask in (part.sliding, part.outside, slower)
            ]
            moving |= motion.moving.any(axis=0)
            used |= bool(part.used.any())
            if not part.last:
                yield part
                continue
            if not used:
                raise too_short(part.path, part.cutoff_hz)
            shares = counts[1:] / np.maximum(counts[0], 1.0)
            use = equations.motion_use(
                part.path, robot, replace(motion, moving=moving[None])
            )
            yield replace(
                part,
                notes=tuple(notes_on(self.model, self.stages, *shares)),
                motion=use,
            )


@dataclass(frozen=True)
class LongPrediction:
    """A long log, opened, and how it is filtered; iterating passes over it, part by part."""

    rows: ClassVar[int] = 32_768  # samples of a part, and twice the margin at least

    log: SurveyedLog
    plan: Plan
    predictor: Predictor

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the temporary file, which is of this process."""
        return {**self.__dict__, "log": replace(self.log, spool=None)}

    def __iter__(self) -> Iterator[LogPrediction]:
        return self.predictor.described(self._parts())

    def _parts(self) -> Iterator[tuple[LogPrediction, Motion]]:
        lowpass, log = self.plan.lowpass, self.log
        # Beside a part, so that the filters forget what lies beyond: parts give what
        # the log does.
        margin = 2 * (lowpass.memory + lowpass.settling)
        with contextlib.ExitStack() as stack:
            if log.spool is None:  # a stored one's copy has gone with its first pass
                file = stack.enter_context(local_copy(log.path))
                log = log if file is log.path else replace(log, file=Path(file))
            blocks = motion_blocks(log.blocks(), self.plan)
            cut = overlapping(blocks, max(self.rows, 2 * margin), margin)
            for number, (motion, start, stop) in enumerate(cut):
                held = Recording(
                    path=log.path,
                    sha256=log.sha256,
                    format=log.format,
                    t=motion.t,
                    q=motion.q,
                    valid=motion.valid,
                    health=Health(log.rate_hz, log.jitter),
                    start=log.start_ns * 1e-9,
                )
                part = self.predictor.part(motion, held, slice(start, stop))
                ends = bool(part.t[-1] * log.rate_hz > log.samples - 1.5)
                yield replace(part, samples=log.samples, part=number, last=ends), motion


def encoder_notes(
    model: TorqueModel,
    motion: Motion,
    of: LogPrediction,
    *,
    min_share: float = 0.5,
    places: int = 50,
) -> Iterator[str]:
    """Say where noise of encoders makes `min_share` or more of the squared error."""
    # Torque that noise of the acceleration makes is taken at so many `places` of the
    # log.
    if motion.source != "encoder" or not motion.cutoff.above_own:
        return
    q = motion.q[:: max(1, motion.samples // places)]
    still = np.zeros_like(q)
    rest, square = model.rigid(q, still, still), np.zeros_like(q)
    for j, error in enumerate(motion.acceleration_error):
        shaken = still.copy()
        shaken[:, j] = error
        square += (model.rigid(q, still, shaken) - rest) ** 2
    noise, slides = PASSED * np.sqrt(square.mean(axis=0)), of.sliding
    counts = np.maximum(slides.sum(axis=0), 1)
    left = np.sqrt(np.sum(np.where(slides, of.residual, 0.0) ** 2, axis=0) / counts)
    loud = [
        f"{joint.name} ({whole:.2g} {joint.unit('N m')})"
        for joint, made, whole in zip(model.robot.joints, noise, left, strict=True)
        if made**2 > min_share * whole**2 > 0.0
    ]
    if loud:
        yield (
            f"at {motion.cutoff.hz:.3g} Hz noise of the encoders makes the error of "
            f"{', '.join(loud)}, for which no model is to blame: "
            f"--cutoff {motion.cutoff.alone_hz:.3g} suits them"
        )


def notes_on(
    model: TorqueModel, stages: Stages, outside: Array, slower: Array
) -> Iterator[str]:
    """Say what a prediction lacks; shares (n,) of sliding samples `outside` friction, `slower`."""
    names = model.robot.joint_names
    if stages.inertia is None:
        yield "no inertia stage in the parameter file: inertial torque is taken as zero"
    unknown = [n for n, s in zip(names, model.surfaces, strict=True) if s is None]
    if unknown:
        yield f"no friction in the parameter file, taken as zero: {', '.join(unknown)}"
    far = [
        f"{name} {percent(part, 0)}"
        + " (slower than its trials)" * bool(2.0 * slow > part)
        for name, part, slow in zip(names, outside, slower, strict=True)
        if part > OUTSIDE_NOTE
    ]
    if far:
        yield (
            "outside the speeds or positions at which friction was identified, so that"
            f" it is extrapolated: {', '.join(far)} of the samples"
        )
