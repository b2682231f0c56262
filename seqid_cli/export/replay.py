"""What was written, run over logs: is it as near to the measured torque as its file.

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
from seqid_cli.effects.measurement import ModelledTorque
from seqid_cli.effects.scene import Scene
from seqid_cli.export.motions import FullModel
from seqid_cli.export.written.arm import Steps, WrittenArm
from seqid_cli.export.written.read import read_written
from seqid_cli.logs.read import read_recording
from seqid_cli.model.torque import sampled_friction
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


@dataclass
class _DeferredFriction:
    """Friction of one joint of a written form, asked for first and answered later.

    A module for numpy takes one state of all joints at a time: what is asked of single
    joints is put together, so that it runs once for all of them.
    """

    sign_width: float
    per_kelvin: float = 0.0  # warmth is an effect of the form, if it knows of it
    asked: list[tuple[Array, Array]] = field(default_factory=list)
    answers: list[Array] = field(default_factory=list)

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque (N,) N m that was answered, or zeros while it is asked for."""
        if self.answers:
            return self.answers.pop(0)
        self.asked.append((q, v))
        return np.zeros(len(q))

    def warmed(self, celsius: Array) -> Array:
        """Return the factor (N,) of temperatures: none here."""
        return np.ones(len(celsius))


def _friction(
    arm: WrittenArm, widths: Sequence[float], motion: Motion
) -> tuple[Array, Array]:
    """Return the friction (N, n) N m of a written form, as it is and sampled as predictions do.

    The latter's steps at reversals are kept below half of the rate.
    """
    laws = [_DeferredFriction(width) for width in widths]
    sampled_friction(laws, motion)
    lengths = [[len(q) for q, _ in law.asked] for law in laws]
    q, v = np.zeros((2, max(map(sum, lengths)), len(laws)))
    for j, law in enumerate(laws):
        q[: sum(lengths[j]), j] = np.concatenate([asked for asked, _ in law.asked])
        v[: sum(lengths[j]), j] = np.concatenate([asked for _, asked in law.asked])
    torque = arm.friction(q, v)
    for j, law in enumerate(laws):
        ends = np.cumsum(lengths[j])
        law.answers = np.split(torque[: ends[-1], j], ends[:-1])
    # What is asked of each joint first are the samples themselves.
    plain = torque[: motion.samples].copy()
    return plain, sampled_friction(laws, motion)


def replayed(
    path: Path,
    kind: str,
    full: FullModel,
    logs: Sequence[Path],
    loss: Mapping[str, float | None],
) -> dict[str, ReplayedJoint]:
    """Run a written file over logs, and compare its errors with those of its parameter file.

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

    Raises
    ------
    SeqidError
        The written file cannot be run, or a log cannot be read.
    """
    robot = full.robot
    squares = np.zeros((2, robot.n))
    counts = np.zeros(robot.n)
    with read_written(path, kind, robot) as arm:
        for log_path in logs:
            log = read_recording(log_path, robot)
            motion = full.motion(log)
            assert motion.tau is not None
            by_file, sliding = full.predicted(log, motion)
            # A form that is slow to run is looked at on the first part of a log.
            run = slice(arm.most_samples)
            scene = full.scene(log, motion)
            smooth = _added_without_steps(full, scene)[run]
            by_form = _torque(arm, full, motion.part(run), _steps(scene, run), smooth)
            by_file, sliding = by_file[run], sliding[run]
            if len(sliding) < log.q.shape[0]:
                # There the low-pass misses what follows.
                sliding[-SETTLINGS_LEFT_OUT * motion.lowpass.settling :] = False
            for row, predicted in enumerate((by_file, by_form)):
                error = np.where(sliding, motion.tau[run] - predicted, 0.0)
                squares[row] += np.square(error).sum(axis=0)
            counts += sliding.sum(axis=0)
    rmse = np.sqrt(squares / np.maximum(counts, 1.0))
    return {
        name: ReplayedJoint(
            file_rmse=float(rmse[0, j]) if counts[j] else None,
            export_rmse=_finite(rmse[1, j]) if counts[j] else None,
            loss=loss.get(name),
            samples=int(counts[j]),
        )
        for j, name in enumerate(robot.joint_names)
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _torque(
    arm: WrittenArm, full: FullModel, motion: Motion, steps: Steps, smooth: Array
) -> Array:
    """Return the torque (N, n) N m of a written form on a motion, filtered as predictions are.

    Parameters
    ----------
    smooth : (N, n) array
        What the file adds to links, rotors and friction that has no steps, N m.
    """
    widths = [0.0 if s is None else s.sign_width for s in full.model.surfaces]
    rigid = arm.rigid(motion.q, motion.dq, motion.ddq)
    plain, friction = _friction(arm, widths, motion)
    known = motion.filtered(rigid) + motion.filtered(friction, times=2)
    if not arm.steps:
        # What delays the logged torque is the log's own matter, and no model file's.
        return full.model.late(known, motion)
    added = arm.stepped(steps) - rigid - plain
    # All of it twice, but for what the second low-pass takes off torque without steps.
    regained = motion.filtered(smooth) - motion.filtered(smooth, times=2)
    return known + motion.filtered(added, times=2) + regained


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
    torque = full.model.late(scene.carried, scene.motion) - scene.carried
    for item in full.effects:
        if not isinstance(item, FittedEffect) or item.passes > 1:
            continue
        if item.effect.body_terms(full.robot, item.joint, item.settings) is not None:
            continue  # which a form has among its links and rotors
        of_torque = isinstance(item.effect, ModelledTorque)
        torque = torque + effect_torque(frictionless if of_torque else scene, [item])
    return torque


def _steps(scene: Scene, run: slice) -> Steps:
    motion, temperature = scene.motion, scene.temperature
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
    """Return a message for every joint at which a written form is worse than it states."""
    found: list[str] = []
    for joint in robot.joints:
        result = joints[joint.name]
        allowed = allowed_rmse(result)
        if allowed is None:
            continue
        error, unit = result.export_rmse, joint.unit("N m")
        if error is not None and error <= allowed:
            continue
        lost = ""
        if result.loss:
            lost = f" and the {result.loss:.3g} {unit} that the form loses there"
        stated = "no number" if error is None else f"{error:.3g} {unit}"
        found.append(
            f"{path}: {joint.name}: the written form errs by {stated} on the replayed"
            f" logs, the parameter file by {result.file_rmse:.3g} {unit}{lost}; at most"
            f" {allowed:.3g} {unit} is allowed"
        )
    return found
