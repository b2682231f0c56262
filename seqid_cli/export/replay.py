"""Errors of written forms on logs, beside those of the files that they come from.

No torque of what was written is that in memory: a C header is compiled, a module
imported, model files are read by the libraries that others read them with. The low-pass
is that of `seqid predict`: once what follows from the smooth motion alone, as links and
rotors do, twice what has steps, as friction has. Samples are those at which a joint
slides.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from seqid_cli.effects.apply import effect_torque
from seqid_cli.effects.fitted import FittedEffect
from seqid_cli.effects.measurement import OfModelledTorque
from seqid_cli.effects.scene import Scene
from seqid_cli.export.motions import FullModel
from seqid_cli.export.written.arm import Steps, WrittenArm
from seqid_cli.export.written.read import read_written
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel, sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.export import ReplayedJoint
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# By how much a written form may be worse than what it states: rounding, other
# libraries' friction at a reversal and the log's own chance stay far below.
MAX_RATIO = 1.1
# Settlings of the low-pass before the end of a shortened run that do not count. The end
# is felt by 1e-3 of the torque after two of them, as many as it has passes, and by 4e-5
# after four.
SETTLINGS_LEFT_OUT = 4
# N m; below it, errors are those of numbers with 15 digits, and their ratio says
# nothing.
_NOTHING = 1e-6


@dataclass(kw_only=True)
class _DeferredFriction:
    """Friction of one joint of a written form, asked for first and answered later.

    A module for numpy takes one state of all joints at a time: what is asked of single
    joints is put together, so that it runs once for all of them.

    Attributes
    ----------
    sign_width : float
        Speed over which the direction of motion changes, rad/s.
    per_kelvin : float
        None: warmth is an effect of the form, if it knows of it.
    positions, velocities : list of array
        The states (N,) of each question, rad and rad/s.
    answers : list of array
        The torque (N,) N m of each question, in their order.
    """

    sign_width: float
    per_kelvin: float = 0.0
    positions: list[Array] = field(default_factory=list)
    velocities: list[Array] = field(default_factory=list)
    answers: list[Array] = field(default_factory=list)

    @property
    def lengths(self) -> list[int]:
        """Number of states of each question."""
        return [len(q) for q in self.positions]

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque (N,) N m of the next answer, zeros while there is none."""
        if self.answers:
            return self.answers.pop(0)
        self.positions.append(q)
        self.velocities.append(v)
        return np.zeros(len(q))

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) of temperatures: none here."""
        return np.ones(len(celsius))


@dataclass(frozen=True, kw_only=True)
class _FormFriction:
    """Friction (N, n) N m of a written form on a motion.

    `plain` is that of the samples, `sampled` as predictions have it: steps at reversals
    are kept below half of the rate.
    """

    plain: Array
    sampled: Array


def _friction(
    arm: WrittenArm, sign_widths: Sequence[float], motion: Motion
) -> _FormFriction:
    """Return the friction of a written form, whose joints have these `sign_widths`."""
    laws = [_DeferredFriction(sign_width=width) for width in sign_widths]
    sampled_friction(laws, motion)

    # One run of the form answers all joints; those with fewer questions stand at zero
    # behind their last.
    shape = (max(sum(law.lengths) for law in laws), len(laws))
    q = np.zeros(shape)
    v = np.zeros(shape)
    for j, law in enumerate(laws):
        count = sum(law.lengths)
        q[:count, j] = np.concatenate(law.positions)
        v[:count, j] = np.concatenate(law.velocities)
    torque = arm.friction(q, v)

    for j, law in enumerate(laws):
        ends = np.cumsum(law.lengths)
        law.answers = np.split(torque[: ends[-1], j], ends[:-1])
    # What is asked of each joint first are the samples themselves.
    plain = torque[: motion.samples].copy()
    return _FormFriction(plain=plain, sampled=sampled_friction(laws, motion))


def replayed(
    path: Path,
    kind: str,
    full: FullModel,
    logs: Sequence[Path],
    loss: Mapping[str, float | None],
) -> dict[str, ReplayedJoint]:
    """Run a written file over logs, and compare its errors with its parameter file's.

    Parameters
    ----------
    path, kind : Path, str
        The written file, and the title of its form.
    full : FullModel
        The parameter file's model.
    logs : sequence of paths
        Logs with torque.
    loss : mapping
        What the form's numbers lose of the file's torque on these logs, by joint, N m.

    Returns
    -------
    dict of str to ReplayedJoint
        RMS errors over the samples of all logs at which the joint slides.

    Raises
    ------
    SeqidError
        The written file cannot be run, or a log cannot be read.
    """
    robot = full.robot
    of_file = np.zeros(robot.n)
    of_form = np.zeros(robot.n)
    samples = np.zeros(robot.n)
    with read_written(path, kind, robot) as arm:
        for log_path in logs:
            log = read_recording(log_path, robot, reading=full.reading)
            errors = _squared_errors(arm, full, log)
            of_file += errors.of_file
            of_form += errors.of_form
            samples += errors.samples

    file_rmse = np.sqrt(of_file / np.maximum(samples, 1.0))
    form_rmse = np.sqrt(of_form / np.maximum(samples, 1.0))
    joints = {}
    for j, name in enumerate(robot.joint_names):
        slides = samples[j] > 0
        joints[name] = ReplayedJoint(
            file_rmse=float(file_rmse[j]) if slides else None,
            export_rmse=_finite(form_rmse[j]) if slides else None,
            loss=loss.get(name),
            samples=int(samples[j]),
        )
    return joints


@dataclass(frozen=True, kw_only=True)
class _SquaredErrors:
    """Squared errors (n,) (N m)^2 on a log, over its sliding `samples` (n,)."""

    of_file: Array
    of_form: Array
    samples: Array


def _squared_errors(arm: WrittenArm, full: FullModel, log: Recording) -> _SquaredErrors:
    """Add up the squared errors of a written form and of its file on one log."""
    motion = full.motion(log)
    assert motion.tau is not None
    torque_of_file, sliding = full.predicted(log, motion)

    # A form that is slow to run is looked at on the first part of a log.
    run = slice(arm.most_samples)
    scene = full.scene(log, motion)
    smooth = _added_without_steps(full, scene)[run]
    torque_of_form = _torque(arm, full, motion.part(run), _steps(scene, run), smooth)

    slides = sliding[run].copy()
    if len(slides) < log.q.shape[0]:
        # There the low-pass misses what follows.
        slides[-SETTLINGS_LEFT_OUT * motion.lowpass.settling :] = False
    error_of_file = np.where(slides, motion.tau[run] - torque_of_file[run], 0.0)
    error_of_form = np.where(slides, motion.tau[run] - torque_of_form, 0.0)
    return _SquaredErrors(
        of_file=np.square(error_of_file).sum(axis=0),
        of_form=np.square(error_of_form).sum(axis=0),
        samples=slides.sum(axis=0),
    )


def _finite(value: float) -> float | None:
    """Return a number, None for one that JSON does not know."""
    return float(value) if math.isfinite(value) else None


def _torque(
    arm: WrittenArm, full: FullModel, motion: Motion, steps: Steps, smooth: Array
) -> Array:
    """Return the torque of a written form on a motion, filtered as predictions are.

    Parameters
    ----------
    arm : WrittenArm
        The written form.
    full : FullModel
        The model of its file.
    motion : Motion
        N samples.
    steps : Steps
        The same, for forms with a state.
    smooth : (N, n) array
        What the file adds to links, rotors and friction that has no steps, N m.

    Returns
    -------
    (N, n) array
        N m (N where prismatic).
    """
    sign_widths = [
        0.0 if surface is None else surface.sign_width
        for surface in full.model.surfaces
    ]
    rigid = arm.rigid(motion.q, motion.dq, motion.ddq)
    friction = _friction(arm, sign_widths, motion)
    torque = motion.filtered(rigid) + motion.filtered(friction.sampled, times=2)
    if not arm.steps:
        # What delays the logged torque is the log's own matter, and no model file's.
        return full.model.late(torque, motion)

    added = arm.stepped(steps) - rigid - friction.plain
    # All of it twice, but for what the second low-pass takes off torque without steps.
    regained = motion.filtered(smooth) - motion.filtered(smooth, times=2)
    # Code knows the past alone: torque that is logged early is the log's own matter.
    earlier = _with_delays(full.model, early=True).late(torque, motion)
    return earlier + motion.filtered(added, times=2) + regained


def _added_without_steps(full: FullModel, scene: Scene) -> Array:
    """Return what the file's effects and delays add that has no steps, unfiltered.

    It follows from motion that was low-passed already, so that predictions low-pass it
    once, like links and rotors. A form says the sum of all that it adds, from which
    this cannot be told. So the file says it: by how much the second low-pass would be
    too many.

    Returns
    -------
    (N, n) array
        N m (N where prismatic).
    """
    # Of functions of the modelled torque it is that of the torque without friction.
    slippery = replace(full.model, surfaces=[None] * full.robot.n)
    frictionless = replace(scene, model=slippery)
    late_model = _with_delays(full.model, early=False)
    torque = late_model.late(scene.carried, scene.motion) - scene.carried
    for item in full.effects:
        if not isinstance(item, FittedEffect) or item.passes > 1:
            continue
        if item.effect.body_terms(full.robot, item.joint, item.settings) is not None:
            continue  # which a form has among its links and rotors
        is_of_torque = isinstance(item.effect, OfModelledTorque)
        torque = torque + effect_torque(frictionless if is_of_torque else scene, [item])
    return torque


def _with_delays(model: TorqueModel, *, early: bool) -> TorqueModel:
    """Return a model whose torque is only ever early, or only ever late."""
    if model.delays_s is None:
        return model
    sign = -1.0 if early else 1.0
    delays_s = np.where(sign * model.delays_s > 0.0, model.delays_s, 0.0)
    return replace(model, delays_s=delays_s)


def _steps(scene: Scene, run: slice) -> Steps:
    """Return the part of a log that a form with a state is stepped with."""
    motion = scene.motion
    temperature = scene.temperature
    return Steps(
        q=motion.q[run],
        dq=motion.dq[run],
        ddq=motion.ddq[run],
        time=scene.time[run],
        temperature=None if temperature is None else temperature[run],
        period=1.0 / motion.rate_hz,
    )


def allowed_rmse(joint: ReplayedJoint) -> float | None:
    """Return the error [N m] up to which a form is as good as it states."""
    if joint.file_rmse is None:
        return None
    # What a form loses may go the same way as what its file lacks: the sizes add up.
    return MAX_RATIO * (joint.file_rmse + (joint.loss or 0.0)) + _NOTHING


def failures(
    joints: Mapping[str, ReplayedJoint], robot: Robot, path: Path
) -> list[str]:
    """Return a message for every joint at which a written form is worse than it states.

    Parameters
    ----------
    joints : mapping of str to ReplayedJoint
        The errors of the form and of its file.
    robot : Robot
        Whose joints these are.
    path : Path
        The written file.
    """
    messages: list[str] = []
    for joint in robot.joints:
        result = joints[joint.name]
        allowed = allowed_rmse(result)
        if allowed is None:
            continue
        error = result.export_rmse
        if error is not None and error <= allowed:
            continue

        unit = joint.unit("N m")
        stated = "no number" if error is None else f"{error:.3g} {unit}"
        lost = ""
        if result.loss:
            lost = f" and the {result.loss:.3g} {unit} that the form loses there"
        messages.append(
            f"{path}: {joint.name}: the written form errs by {stated} on the replayed"
            f" logs, the parameter file by {result.file_rmse:.3g} {unit}{lost}; at most"
            f" {allowed:.3g} {unit} is allowed"
        )
    return messages
