"""From recordings to data sets: filtered motion, the model's torque, one clock for all logs."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.floor import encoder_residuals
from seqid_cli.discover.select.options import Options
from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.inspect.dynamics.echo import REMEDY, WARNING, echoes
from seqid_cli.logs.pieces import by_log, whole_of
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.effects.apply import scene_of_log
from seqid_cli.model.effects.scene import LONGEST_SESSION_S, Scene, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.imu.link_acceleration import log_motion
from seqid_cli.motion.motion import decimated, estimate_motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

# enough for steps of friction, whose time is known to half a sample
SAMPLES_PER_CUTOFF = 24


def scenes_of(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
) -> list[Scene]:
    """Build the data set of every log with torque or current, with the model as it stands."""
    logs = list(recordings)
    motions = []
    imu, source = stages.imu, options.source
    for log in logs:
        torque_of(log)  # there, before the motion is worked out
        motions.append(log_motion(log, robot, options.motion, imu=imu, source=source))
    model = TorqueModel.from_stages(stages, robot)
    starts, shared = shared_starts(logs)
    top = np.max([np.max(np.abs(motion.dq), axis=0) for motion in motions], axis=0)
    width = sign_widths(model, top)
    scenes = []
    for number, (log, motion, start) in enumerate(
        zip(logs, motions, starts, strict=True)
    ):
        alone = scene_of_log(log, robot, model, motion)
        place = replace(
            alone, log=number, start=start, shared_clock=shared, sign_width=width
        )
        scenes.append(thinned(replace(place, encoder=log.q, measured=log.tau)))
    return scenes


def with_own_cutoffs(
    logs: Sequence[Recording], robot: Robot, stages: Stages, options: InertiaOptions
) -> InertiaOptions:
    """Options that filter logs at their own cut-off where encoders are too coarse for the model's.

    Unless the user gave the cut-off, and where no IMU helps. What motion is made is
    kept.
    """
    if options.motion.kept is None:
        options = replace(options, motion=replace(options.motion, kept={}))
    if options.motion.origin == "as given":
        return options
    alone = [
        x for x in logs if estimate_motion(x, robot, options.motion).cutoff.above_own
    ]
    scenes = scenes_of(alone, robot, stages, options=options) if alone else []
    own = {
        log.sha256
        for log, scene in zip(alone, scenes, strict=True)
        if _is_coarse(log, scene)
    }
    return replace(
        options, motion=replace(options.motion, own=options.motion.own | own)
    )


def _is_coarse(
    log: Recording, scene: Scene, *, most: float = Options.improvement
) -> bool:
    """Whether encoder noise makes a share, of which terms count, of what the model leaves."""
    if scene.motion.source != "encoder":
        return False
    every = encoder_residuals([log], [scene])[0], residual_of(scene)
    made, whole = (np.sum(np.where(scene.slides, x, 0.0) ** 2, axis=0) for x in every)
    return bool(np.any(made > most * whole))


def thinned(full: Scene) -> Scene:
    """The data set at the rate at which most effects are looked for, with the full one inside."""
    motion = decimated(full.motion, SAMPLES_PER_CUTOFF)
    every = round(full.motion.rate_hz / motion.rate_hz)
    logged = (full.temperature, full.sensor, full.encoder)
    temperature, sensor, encoder = (None if x is None else x[::every] for x in logged)
    kept = replace(full, temperature=temperature, sensor=sensor, encoder=encoder)
    return replace(kept, motion=motion, measured=None, full=full)


def shared_starts(recordings: Sequence[Recording]) -> tuple[list[float], bool]:
    """Seconds from the earliest log's start to each log's, and whether the logs tell them.

    Logs whose own clocks all begin at zero, or lie years apart, tell nothing of it. Of
    pieces it is the logs that are asked, and a piece knows at any rate where in its log
    it begins.
    """
    logs = [whole_of(pieces[0]) for pieces in by_log(recordings)]
    begun, lengths = np.array([(whole.start, whole.length) for whole in logs]).T
    order = np.argsort(begun, kind="stable")
    apart = np.all(np.diff(begun[order]) >= 0.5 * lengths[order][:-1])
    if not apart or np.ptp(begun) >= LONGEST_SESSION_S:
        return [recording.offset for recording in recordings], False
    starts = np.array([recording.start for recording in recordings])
    return [float(x) for x in starts - starts.min()], True


def usable_logs(
    recordings: Iterable[Recording], robot: Robot
) -> tuple[list[Recording], tuple[str, ...]]:
    """Leave out logs whose torque is an echo of the command (see `inspect.dynamics.echo`).

    A log that comes in pieces is one if half of these are. Returns what is left, and a
    note on every log that was left out. Raises InputError: nothing is left.
    """
    kept, left_out = list[Recording](), list[tuple[str, str]]()
    for pieces in by_log(recordings):
        every = [
            echoes(robot, x.t, x.q, x.tau, x.valid) for x in pieces if x.tau is not None
        ]
        echoed = [
            ", ".join(robot.joint_names[j] for j in found)
            for found in every
            if len(found)
        ]
        if 2 * len(echoed) >= len(pieces) and echoed:
            left_out.append((str(pieces[0].path), echoed[0]))
        else:
            kept += pieces
    if left_out and not kept:
        path, first = left_out[0]
        others = f" (and {len(left_out) - 1} more logs)" if len(left_out) > 1 else ""
        raise InputError(f"joint {first}: {WARNING}{others}", where=path, hint=REMEDY)
    return kept, tuple(
        f"{p} is left out: joint {j}: {WARNING}; {REMEDY}" for p, j in left_out
    )
