"""Effects at work: their torque on any log, and logs without them.

Which log is number 3 and when time began is said by the session of an effect; a log
that the session does not know is placed by its own clock, after the logs that started
before it. Without a common clock it counts as recorded after all of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from seqid_cli.effects.effect import acts_in_log
from seqid_cli.effects.fitted import Fitted, FittedEffect
from seqid_cli.effects.measurement import MeasurementEffect
from seqid_cli.effects.scene import LONGEST_SESSION_S, Scene, sign_widths
from seqid_cli.imu.link_acceleration import log_motion
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.torque import Predicted, TorqueModel
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import EffectSession, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


def session_of(
    recordings: Sequence[Recording], starts: Sequence[float], shared: bool
) -> EffectSession:
    """Describe the logs that effects are identified from.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order of the scenes.
    starts : sequence of float
        Starts of the scenes [s].
    shared : bool
        Whether the logs share a clock.
    """
    logs = [recording.sha256 for recording in recordings]
    if not shared or not recordings:
        return EffectSession(logs=logs)
    origin = min(recording.start for recording in recordings)
    return EffectSession(
        logs=logs, starts=[float(start) for start in starts], origin=origin
    )


def scene_of_log(
    recording: Recording, robot: Robot, model: TorqueModel, motion: Motion
) -> Scene:
    """Return the scene of one log by itself.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    model : TorqueModel
    motion : Motion
        Of the log, possibly decimated.
    """
    load = recording.load
    temperature = recording.temperature
    kept_samples = slice(None, None, round(recording.rate_hz / motion.rate_hz))
    return Scene(
        robot=robot,
        motion=motion,
        model=model,
        sign_width=sign_widths(model, np.max(np.abs(motion.dq), axis=0)),
        start=recording.offset,
        period=1.0 / recording.rate_hz,
        temperature=None if temperature is None else temperature[kept_samples],
        sensor=None if load is None else motion.filtered(load[kept_samples]),
    )


def placed(scene: Scene, recording: Recording, session: EffectSession | None) -> Scene:
    """Return the scene as a session counts it: number, start, clock.

    Parameters
    ----------
    scene : Scene
        Of the log by itself.
    recording : Recording
        The log.
    session : EffectSession, optional
        None leaves the scene as it is.
    """
    if session is None:
        return scene

    place = place_of(recording, session)
    return replace(
        scene,
        log=place.log,
        start=recording.offset if place.start is None else place.start,
        shared_clock=place.start is not None,
    )


class Place(NamedTuple):
    """Where a log stands in a session.

    `log` is its number, `start` [s] that of its clock, None where the session has no
    clock, or the log another one.
    """

    log: int
    start: float | None


def place_of(recording: Recording, session: EffectSession) -> Place:
    """Return where a log stands in a session."""
    # A session may know a recording by its own digest, or by that of its log.
    digests = [recording.sha256]
    if recording.source_log:
        digests.append(recording.source_log.sha256)
    digest = next((digest for digest in digests if digest in session.logs), None)
    if digest is not None:
        number = session.logs.index(digest)
        if not session.starts:
            return Place(log=number, start=None)
        within_log = 0.0 if digest == recording.sha256 else recording.offset
        return Place(log=number, start=session.starts[number] + within_log)

    # A log that the session does not know, without a common clock or of another time.
    if (
        session.origin is None
        or abs(recording.start - session.origin) > LONGEST_SESSION_S
    ):
        return Place(log=len(session.logs), start=None)

    # By the clock it follows the log of the session that started last before it.
    start = recording.start - session.origin
    earlier = [k for k, other in enumerate(session.starts) if other <= start]
    number = max(earlier, key=lambda k: session.starts[k]) if earlier else -1
    return Place(log=number, start=start)


def effect_torque(scene: Scene, fitted: Sequence[Fitted]) -> Array:
    """Compute the torque of effects, unfiltered.

    Parameters
    ----------
    scene : Scene
        Placed in the session of the effects.
    fitted : sequence of FittedEffect or SmoothTerm

    Returns
    -------
    Array
        (N, n) N m.
    """
    total = np.zeros_like(scene.motion.q)
    for effect in fitted:
        for j, torque in effect.torques(scene).items():
            total[:, j] += torque
    return total


def added_torque(
    scene: Scene, recording: Recording, fitted: Sequence[Fitted], slowest: Array
) -> Predicted:
    """Compute what effects add to a log's prediction.

    Parameters
    ----------
    scene : Scene
        Of the log by itself.
    recording : Recording
    fitted : sequence of FittedEffect or SmoothTerm
    slowest : Array
        (n,) rad/s. At rest effects of friction may have anything up to their torque at
        this speed.

    Returns
    -------
    Predicted
        Each (N, n) N m, low-passed.
    """
    torque = np.zeros_like(scene.motion.q)
    low = np.zeros_like(scene.motion.q)
    high = np.zeros_like(scene.motion.q)
    for placed_scene, effects in _by_session(scene, recording, fitted):
        # Effects with the same number of passes are filtered together.
        for passes in {effect.passes for effect in effects}:
            same_passes = [effect for effect in effects if effect.passes == passes]
            unfiltered = effect_torque(placed_scene, same_passes)
            torque += scene.motion.filtered(unfiltered, times=passes)

        friction = [
            effect
            for effect in effects
            if isinstance(effect, FittedEffect) and effect.effect.family == "friction"
        ]
        if friction:
            forward = effect_torque(_at_speed(placed_scene, slowest), friction)
            backward = effect_torque(_at_speed(placed_scene, -slowest), friction)
            high += np.maximum(forward, 0.0)
            low += np.minimum(backward, 0.0)
    return Predicted(torque, low, high)


def effects_variance(
    scene: Scene, recording: Recording, fitted: Sequence[Fitted]
) -> Array:
    """Compute the variance of the effects' torque by errors of their coefficients.

    Settings (a speed, an order, a lag) count as known. Effects count as independent of
    each other: a file says nothing of what their errors have in common.

    Returns
    -------
    Array
        (N, n) (N m)^2.
    """
    variance = np.zeros_like(scene.motion.q)
    for placed_scene, effects in _by_session(scene, recording, fitted):
        for item in effects:
            if not isinstance(item, FittedEffect) or not item.covariance.any():
                continue
            columns = item.effect.columns_in_log(
                placed_scene, item.joint, item.settings
            )
            for j, unfiltered in columns.items():
                X = scene.motion.filtered(unfiltered, times=item.passes)
                variance[:, j] += np.sum((X @ item.covariance) * X, axis=1)
    return variance


def _at_speed(scene: Scene, speed: Array) -> Scene:
    """Return the scene as if all joints moved steadily at speeds (n,), wherever."""
    motion = scene.motion
    steady = np.broadcast_to(speed, motion.q.shape).copy()
    return replace(scene, motion=replace(motion, dq=steady, ddq=np.zeros_like(steady)))


def _by_session(
    scene: Scene, recording: Recording, fitted: Sequence[Fitted]
) -> Iterator[tuple[Scene, list[Fitted]]]:
    """Split effects by session, each with the scene placed in it."""
    remaining = list(fitted)
    while remaining:
        session = remaining[0].session
        of_session = [effect for effect in remaining if effect.session == session]
        yield placed(scene, recording, session), of_session
        remaining = [effect for effect in remaining if effect.session != session]


def without_effects(
    recording: Recording,
    robot: Robot,
    stages: Stages,
    fitted: Sequence[Fitted],
    *,
    motion: MotionOptions,
    source: str = "auto",
) -> Recording:
    """Return a recording with torque as it would be without some effects.

    Effects of the measurement are undone in the channel that they distort: torque is
    scaled, shifted in time or sent through the drive's lag, an encoder's error is taken
    off the position. The torque of all others is subtracted.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    stages : Stages
        The model, by whose torques effects follow from the motion.
    fitted : sequence of FittedEffect or SmoothTerm
    motion : MotionOptions
    source : {"auto", "encoder", "imu"}
        Where accelerations come from.

    Returns
    -------
    Recording
        At its own rate.

    Raises
    ------
    InputError
        The log carries neither torque nor current.
    """
    torque_of(recording)
    to_subtract: list[Fitted] = []
    for item in fitted:
        if isinstance(item, FittedEffect) and isinstance(
            item.effect, MeasurementEffect
        ):
            number = place_of(recording, item.session).log if item.session else 0
            if acts_in_log(number, item.settings):
                recording = item.effect.restored(
                    recording, robot, item.joint, item.settings, item.coefficients
                )
        else:
            to_subtract.append(item)
    if not to_subtract:
        return recording

    assert recording.tau is not None
    best = log_motion(recording, robot, motion, imu=stages.imu, source=source)
    model = TorqueModel.from_stages(stages, robot)
    scene = scene_of_log(recording, robot, model, best)
    torque = np.zeros_like(recording.tau)
    for placed_scene, effects in _by_session(scene, recording, to_subtract):
        torque += effect_torque(placed_scene, effects)
    return replace(recording, tau=recording.tau - torque)
