"""Effects at work: their torque on any log, and logs without them.

Which log is number 3 and when time began is said by the session of an effect; a log
that the session does not know is placed by its own clock, after the logs that started
before it. Without a common clock it counts as recorded after all of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.effects.measurement import MeasurementEffect
from seqid_cli.model.effects.scene import LONGEST_SESSION_S, Scene, sign_widths
from seqid_cli.model.torque import Predicted, TorqueModel
from seqid_cli.motion.imu.link_acceleration import log_motion
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import EffectSession, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


def session_of(
    recordings: Sequence[Recording], starts: Sequence[float], shared: bool
) -> EffectSession:
    """Describe the logs that effects are identified from, in the order of the scenes.

    `starts` are those of the scenes, s; `shared` says whether the logs share a clock.
    """
    logs = [recording.sha256 for recording in recordings]
    if not shared or not recordings:
        return EffectSession(logs=logs)
    origin = min(recording.start for recording in recordings)
    return EffectSession(logs=logs, starts=[float(x) for x in starts], origin=origin)


def scene_of_log(
    recording: Recording, robot: Robot, model: TorqueModel, motion: Motion
) -> Scene:
    """Return the scene of one log by itself; `motion` is of it, possibly decimated."""
    load, temperature = recording.load, recording.temperature
    picked = slice(None, None, round(recording.rate_hz / motion.rate_hz))
    return Scene(
        robot=robot,
        motion=motion,
        model=model,
        sign_width=sign_widths(model, np.max(np.abs(motion.dq), axis=0)),
        start=recording.offset,
        period=1.0 / recording.rate_hz,
        temperature=None if temperature is None else temperature[picked],
        sensor=None if load is None else motion.filtered(load[picked]),
    )


def placed(scene: Scene, recording: Recording, session: EffectSession | None) -> Scene:
    """Return the scene as a session counts it: number, start, clock."""
    if session is None:
        return scene
    # A session may know a recording by its own digest, or by that of its log.
    names = [recording.sha256, *([recording.whole.sha256] if recording.whole else [])]
    known = next((x for x in names if x in session.logs), None)
    if known is not None:
        number = session.logs.index(known)
        within = 0.0 if known == recording.sha256 else recording.offset
        if not session.starts:
            return replace(
                scene, log=number, start=recording.offset, shared_clock=False
            )
        return replace(
            scene, log=number, start=session.starts[number] + within, shared_clock=True
        )
    last = len(session.logs)
    if (
        session.origin is None
        or abs(recording.start - session.origin) > LONGEST_SESSION_S
    ):
        return replace(scene, log=last, start=recording.offset, shared_clock=False)
    start = recording.start - session.origin
    before = [k for k, other in enumerate(session.starts) if other <= start]
    number = max(before, key=lambda k: session.starts[k]) if before else -1
    return replace(scene, log=number, start=start, shared_clock=True)


def effect_torque(scene: Scene, fitted: Sequence[Fitted]) -> Array:
    """Torque (N, n) N m of effects, unfiltered, on a scene that is placed in their session."""
    total = np.zeros_like(scene.motion.q)
    for item in fitted:
        for j, torque in item.torques(scene).items():
            total[:, j] += torque
    return total


def added_torque(
    scene: Scene, recording: Recording, fitted: Sequence[Fitted], slowest: Array
) -> Predicted:
    """What effects add to a log's prediction; at rest up to friction's at `slowest` (n,)."""
    torque, low, high = (np.zeros_like(scene.motion.q) for _ in range(3))
    for place, items in _by_session(scene, recording, fitted):
        for passes in {item.passes for item in items}:
            same = [item for item in items if item.passes == passes]
            torque += scene.motion.filtered(effect_torque(place, same), times=passes)
        laws = (x for x in items if isinstance(x, FittedEffect))
        rubbing = [x for x in laws if x.effect.family == "friction"]
        if rubbing:
            high += np.maximum(effect_torque(_at_speed(place, slowest), rubbing), 0.0)
            low += np.minimum(effect_torque(_at_speed(place, -slowest), rubbing), 0.0)
    return Predicted(torque, low, high)


def effects_variance(
    scene: Scene, recording: Recording, fitted: Sequence[Fitted]
) -> Array:
    """Return the variance (N, n) (N m)^2 of the effects' torque by errors of their coefficients.

    Settings (a speed, an order, a lag) count as known. Effects count as independent of
    each other: a file says nothing of what their errors have in common.
    """
    variance = np.zeros_like(scene.motion.q)
    for place, items in _by_session(scene, recording, fitted):
        laws = [item for item in items if isinstance(item, FittedEffect)]
        for law in laws:
            if not law.covariance.any():
                continue
            columns = law.effect.columns(place, law.joint, law.settings)
            for j, unfiltered in columns.items():
                X = scene.motion.filtered(unfiltered, times=law.passes)
                variance[:, j] += np.sum((X @ law.covariance) * X, axis=1)
    return variance


def _at_speed(scene: Scene, speed: Array) -> Scene:
    """Return the scene as if every joint moved steadily at a speed (n,), wherever it is."""
    motion = scene.motion
    steady = np.broadcast_to(speed, motion.q.shape).copy()
    return replace(scene, motion=replace(motion, dq=steady, ddq=np.zeros_like(steady)))


def _by_session(
    scene: Scene, recording: Recording, fitted: Sequence[Fitted]
) -> Iterator[tuple[Scene, list[Fitted]]]:
    """Split effects by session, each with the scene placed in it."""
    left = list(fitted)
    while left:
        session = left[0].session
        yield (
            placed(scene, recording, session),
            [x for x in left if x.session == session],
        )
        left = [x for x in left if x.session != session]


def without_effects(
    recording: Recording,
    robot: Robot,
    stages: Stages,
    fitted: Sequence[Fitted],
    *,
    motion: MotionOptions,
    source: str = "auto",
) -> Recording:
    """Return a recording with torque as it would be without the `fitted` effects, at its own rate.

    Effects of the measurement are undone in the channel that they distort: torque is
    scaled, shifted in time or sent through the drive's lag, an encoder's error is taken
    off the position. The torque of all others, as the model in `stages` says it, is
    subtracted. `source` {"auto", "encoder", "imu"} says where accelerations come from.
    Raises InputError if the log carries neither torque nor current.
    """
    torque_of(recording)
    rest: list[Fitted] = []
    for item in fitted:
        if isinstance(item, FittedEffect) and isinstance(
            item.effect, MeasurementEffect
        ):
            joint, settings, c = item.joint, item.settings, item.coefficients
            recording = item.effect.restored(recording, robot, joint, settings, c)
        else:
            rest.append(item)
    if not rest:
        return recording
    assert recording.tau is not None
    best = log_motion(recording, robot, motion, imu=stages.imu, source=source)
    scene = scene_of_log(recording, robot, TorqueModel.from_stages(stages, robot), best)
    torque = np.zeros_like(recording.tau)
    for place, items in _by_session(scene, recording, rest):
        torque += effect_torque(place, items)
    return replace(recording, tau=recording.tau - torque)
