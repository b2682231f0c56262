"""From recordings to data sets: filtered motion, the model's torque, one clock."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.floor import encoder_residuals
from seqid_cli.discover.settings import EvidenceSettings
from seqid_cli.effects.apply import scene_of_log
from seqid_cli.effects.link_readings import link_readings
from seqid_cli.effects.payload import Payload
from seqid_cli.effects.scene import LONGEST_SESSION_S, Scene, sign_widths
from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.imu.link_acceleration import log_motion
from seqid_cli.inspect.dynamics.echo import REMEDY, WARNING, echoes
from seqid_cli.inspect.settings import EchoSettings
from seqid_cli.logs.recording import Recording, by_log, torque_of
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.motion import decimated, estimate_motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# enough for steps of friction, whose time is known to half a sample
SAMPLES_PER_CUTOFF = 24


def scenes_of(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
) -> list[Scene]:
    """Build the data set of every log with torque or current.

    Parameters
    ----------
    recordings : iterable of Recording
        The logs.
    robot : Robot
        The arm.
    stages : Stages
        The model as it stands.
    options : InertiaOptions
        Where motion comes from, and how it is low-passed.

    Returns
    -------
    list of Scene
        With the model's torque along the motion, all on one clock where the logs tell
        it.
    """
    logs = list(recordings)
    motions = []
    for log in logs:
        torque_of(log)  # is there, before the motion is worked out
        motion = log_motion(
            log, robot, options.motion, imu=stages.imu, source=options.source
        )
        motions.append(motion)

    model = TorqueModel.from_stages(stages, robot)
    starts, is_shared = shared_starts(logs)
    top_speed = np.max([np.max(np.abs(x.dq), axis=0) for x in motions], axis=0)
    sign_width = sign_widths(model, top_speed)
    last_link = last_link_of(robot, stages)

    scenes = []
    for number, (log, motion, start) in enumerate(
        zip(logs, motions, starts, strict=True)
    ):
        scene = replace(
            scene_of_log(log, robot, model, motion),
            log=number,
            start=start,
            shared_clock=is_shared,
            sign_width=sign_width,
            encoder=log.q,
            measured=log.tau,
            links=link_readings(log, robot, stages.imu, motion.lowpass),
            last_link=last_link,
        )
        scenes.append(thinned(scene))
    return scenes


def last_link_of(robot: Robot, stages: Stages) -> Array | None:
    """Return what the files say of the last link and of what it carries.

    Base parameters do not tell a link's mass from that of the link before: only the
    inertials of the URDF do, and payloads that were added to the model.

    Parameters
    ----------
    robot : Robot
        The arm.
    stages : Stages
        The model with its effects.

    Returns
    -------
    (10,) array or None
        Inertial parameters in the frame of the last joint; None where nothing says any.
    """
    payloads = [
        np.array(entry.coefficients)
        for entry in stages.effects or []
        if entry.effect == Payload.name and len(entry.coefficients) == PER_LINK
    ]
    known = payloads if robot.nominal is None else [robot.nominal[-1], *payloads]
    return np.sum(known, axis=0) if known else None


def with_own_cutoffs(
    logs: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
    settings: EvidenceSettings = EvidenceSettings(),
) -> InertiaOptions:
    """Return options that filter some logs at their own cut-off.

    They are the logs whose encoders are too coarse for the model's cut-off, unless the
    user gave it, and where no IMU helps. What motion is made is kept.

    Parameters
    ----------
    logs : sequence of Recording
        The logs.
    robot : Robot
        The arm.
    stages : Stages
        The model.
    options : InertiaOptions
        As the user gave them.
    settings : EvidenceSettings
        They say which share of a residual matters.
    """
    if options.motion.kept is None:
        options = replace(options, motion=replace(options.motion, kept={}))
    if options.motion.origin == "as given":
        return options

    doubtful = [
        log
        for log in logs
        if estimate_motion(log, robot, options.motion).cutoff.above_own
    ]
    if not doubtful:
        return options
    scenes = scenes_of(doubtful, robot, stages, options=options)
    coarse = {
        log.sha256
        for log, scene in zip(doubtful, scenes, strict=True)
        if _is_coarse(log, scene, settings.negligible_share)
    }
    motion = replace(
        options.motion,
        logs_with_own_cutoff=options.motion.logs_with_own_cutoff | coarse,
    )
    return replace(options, motion=motion)


def _is_coarse(log: Recording, scene: Scene, most: float) -> bool:
    """Return whether encoder noise makes more than a share `most` of some residual.

    By the squares of a joint where it slides; the share is the one from which on terms
    count.
    """
    if scene.motion.source != "encoder":
        return False

    def square(residual: Array) -> Array:
        return np.asarray(np.sum(np.where(scene.slides, residual, 0.0) ** 2, axis=0))

    made_by_encoder = square(encoder_residuals([log], [scene])[0])
    return bool(np.any(made_by_encoder > most * square(residual_of(scene))))


def thinned(full: Scene) -> Scene:
    """Return the data set at the rate at which most effects are looked for.

    The full one stands inside.
    """
    motion = decimated(full.motion, SAMPLES_PER_CUTOFF)
    stride = round(full.motion.rate_hz / motion.rate_hz)

    def thin(values: Array | None) -> Array | None:
        return None if values is None else values[::stride]

    return replace(
        full,
        motion=motion,
        temperature=thin(full.temperature),
        sensor=thin(full.sensor),
        encoder=thin(full.encoder),
        measured=None,
        links=tuple(imu.every(stride) for imu in full.links),
        full=replace(full, links=()),
    )


def shared_starts(recordings: Sequence[Recording]) -> tuple[list[float], bool]:
    """Return when each log starts, and whether the logs share a clock.

    Logs whose own clocks all begin at zero, or lie years apart, tell nothing of it. Of
    pieces it is the logs that are asked, and a piece knows at any rate where in its log
    it begins.

    Returns
    -------
    list of float
        Seconds from the earliest log's start; without a clock from the own log's.
    bool
        Whether the logs share a clock.
    """
    logs = [pieces[0].whole for pieces in by_log(recordings)]
    log_starts = np.array([log.start for log in logs])
    lengths = np.array([log.length for log in logs])
    order = np.argsort(log_starts, kind="stable")

    # Logs that lie over one another were not recorded with one clock.
    gaps = np.diff(log_starts[order])
    is_in_sequence = bool(np.all(gaps >= 0.5 * lengths[order][:-1]))
    if not is_in_sequence or np.ptp(log_starts) >= LONGEST_SESSION_S:
        return [recording.offset for recording in recordings], False
    starts = np.array([recording.start for recording in recordings])
    return [float(seconds) for seconds in starts - starts.min()], True


def usable_logs(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    settings: EchoSettings = EchoSettings(),
) -> tuple[list[Recording], tuple[str, ...]]:
    """Leave out logs whose torque is an echo of the command.

    See `inspect.dynamics.echo`. A log that comes in pieces is one if half of these are.

    Parameters
    ----------
    recordings : iterable of Recording
        The logs.
    robot : Robot
        The arm.
    settings : EchoSettings
        How much friction an echo may seem to have.

    Returns
    -------
    list of Recording
        What stays.
    tuple of str
        A note on every log that was left out.

    Raises
    ------
    InputError
        Nothing is left.
    """
    usable: list[Recording] = []
    left_out: list[tuple[str, str]] = []  # paths, with the joints that are echoes
    for pieces in by_log(recordings):
        echoing_joints = _echoes_of(pieces, robot, settings)
        if echoing_joints and 2 * len(echoing_joints) >= len(pieces):
            left_out.append((str(pieces[0].path), echoing_joints[0]))
        else:
            usable += pieces

    if left_out and not usable:
        path, joints = left_out[0]
        n_others = len(left_out) - 1
        and_others = f" (and {n_others} more logs)" if n_others else ""
        raise InputError(
            f"joint {joints}: {WARNING}{and_others}", where=path, hint=REMEDY
        )
    notes = [
        f"{path} is left out: joint {joints}: {WARNING}; {REMEDY}"
        for path, joints in left_out
    ]
    return usable, tuple(notes)


def _echoes_of(
    pieces: Sequence[Recording], robot: Robot, settings: EchoSettings
) -> list[str]:
    """Return the joints whose torque is an echo, for every piece that has any."""
    echoing = []
    for piece in pieces:
        if piece.tau is None:
            continue
        joints = echoes(
            robot, piece.t, piece.q, piece.tau, piece.valid, settings=settings
        )
        if len(joints):
            echoing.append(", ".join(robot.joint_names[joint] for joint in joints))
    return echoing
