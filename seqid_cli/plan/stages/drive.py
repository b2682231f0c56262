"""Plan the logs of `seqid drive`: what shows every number of a position controller.

- *Chirp*: waves of all joints from slow to twice the bandwidth of their loops, with
  less than half of the torque, for gains, feed-forward and delays.
- *Slow*: a Fourier motion of all joints over their ranges, for friction and gravity.
- *Steps and holds*: of each joint, small ones below the limits, and rests behind them,
  for the integral and for friction that holds.

Joints chirp together: a controller's law is of its own joint alone. The sweep of each
is a little faster than that of the one before, so that no two are alike.
"""

from dataclasses import replace

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.motion.planned import COEFFICIENTS, Shapes, sampled, waves
from seqid_cli.params.results.plan import (
    ChirpMotion,
    FourierMotion,
    PlannedMove,
    PlannedStage,
    Stroke,
)
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import Moves, placed
from seqid_cli.plan.moves.strokes import postures_of, seconds_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.typing import Array

CHIRP_S = 20.0
SLOW_S = 30.0
RATE_HZ = 200.0  # at which moves are checked
BEYOND = 2.0  # times the bandwidth, to which waves go
LOWEST_HZ = 0.2
CORNER_HZ = 1.0  # above it waves get smaller, so that their acceleration does not grow
APART = 0.05  # by which each joint's sweep is faster than that of the one before
TORQUE_SHARE = 0.5  # of the limit: beyond it a step more would reach it
RANGE_SHARE = 0.25  # of a joint's range, for waves to either side
SLOW_SHARE = 0.4  # of the speeds that a slow motion may have
STEP_SHARES = (0.02, 0.05)  # of a joint's range
HOLD_S = 2.5  # behind each step
CRAWL_SHARE = 1e-4  # of the range, that a joint goes while it holds
POSTURES = 60
GENTLER = 0.7  # times as large, where torque, floor or links are in the way
TRIES = 8


def plan_drive(belief: Belief, options: PlanOptions) -> Planned:
    """Plan a chirp, a slow motion, and steps with holds of each joint.

    Parameters
    ----------
    belief : Belief
    options : PlanOptions

    Returns
    -------
    Planned

    Raises
    ------
    ConfigError
        No posture is free for a move, or gravity alone needs too much torque.
    """
    rng = np.random.default_rng(options.seed)
    postures = postures_of(belief.limits, POSTURES, rng)
    moves = [
        _chirp(belief, postures, options.bandwidth_hz),
        _slow(belief, rng),
        *(_steps(belief, postures, j) for j in belief.limits.moving),
    ]
    highest_hz = BEYOND * options.bandwidth_hz
    notes = [
        f"waves go up to {highest_hz:.3g} Hz, twice a bandwidth of"
        f" {options.bandwidth_hz:.3g} Hz (--bandwidth)",
        "log commands when they are sent, and rows faster than commands",
        "limits of torque and speed show only where they are reached: no move does, so"
        " that nothing has to be left out",
    ]
    return Planned(moves, PlannedStage(notes=notes))


def _is_free(belief: Belief, move: PlannedMove) -> bool:
    """Tell whether a move stays in its limits, below half of the torque, and free."""
    names = belief.robot.joint_names
    t, q, dq, ddq = sampled(move, names, RATE_HZ)
    limits = belief.limits
    rounding = 1.0 + 1e-9
    inside = (
        (q >= limits.lower - 1e-9).all()
        and (q <= limits.upper + 1e-9).all()
        and (np.abs(dq) <= rounding * limits.speed)[:, limits.moves].all()
        and (np.abs(ddq) <= rounding * limits.acceleration)[:, limits.moves].all()
    )
    if not inside:
        return False
    states = Moves(t, q[None], dq[None], ddq[None]).every(4)
    torque = belief.torque(states, belief.regressor(states))
    if (torque > TORQUE_SHARE * limits.torque).any():
        return False
    return not belief.collides(states.q).any()


def _nothing_free(belief: Belief, what: str) -> ConfigError:
    return ConfigError(
        f"no {what} is free of floor and links with half of the torque",
        where=str(belief.robot.source),
        hint="Give --no-floor, widen position_limits, or correct effort in the URDF.",
    )


def _start(belief: Belief, posture: Array) -> dict[str, float]:
    return dict(zip(belief.robot.joint_names, posture.tolist(), strict=True))


def _chirp(belief: Belief, postures: Array, bandwidth_hz: float) -> PlannedMove:
    """Return waves of all joints, about the first posture that is free for them."""
    limits = belief.limits
    names = belief.robot.joint_names
    t = np.arange(round(CHIRP_S * RATE_HZ) + 1) / RATE_HZ
    unit = []
    amplitudes = np.zeros(belief.robot.n)
    for k, j in enumerate(limits.moving):
        faster = 1.0 + APART * k
        chirp = ChirpMotion(
            centre=0.0,
            amplitude=1.0,
            lowest_hz=LOWEST_HZ * faster,
            highest_hz=BEYOND * bandwidth_hz * faster,
            corner_hz=CORNER_HZ,
        )
        unit.append(chirp)
        _, speed, acceleration = np.abs(waves(chirp, t)).max(axis=1)
        amplitudes[j] = min(
            RANGE_SHARE * limits.range[j],
            limits.speed[j] / speed,
            limits.acceleration[j] / acceleration,
        )
    for attempt in range(TRIES):
        size = GENTLER**attempt
        for drawn in postures:
            reach = size * amplitudes
            posture = np.clip(drawn, limits.lower + reach, limits.upper - reach)
            chirps = {
                names[j]: ChirpMotion(
                    centre=float(posture[j]),
                    amplitude=float(size * amplitudes[j]),
                    lowest_hz=shape.lowest_hz,
                    highest_hz=shape.highest_hz,
                    corner_hz=shape.corner_hz,
                )
                for shape, j in zip(unit, limits.moving, strict=True)
            }
            move = PlannedMove(
                name="drive_chirp",
                stage="",
                joints=list(chirps),
                duration_s=CHIRP_S,
                start=_start(belief, posture),
                chirp=chirps,
            )
            if _is_free(belief, move):
                return move
    raise _nothing_free(belief, "chirp")


def _slow(belief: Belief, rng: np.random.Generator) -> PlannedMove:
    """Return a slow motion of all joints over what is free of their ranges."""
    names = belief.robot.joint_names
    slow = replace(belief.limits, speed=SLOW_SHARE * belief.limits.speed)
    shapes = Shapes.over(SLOW_S, RATE_HZ)
    size = 1.0
    for attempt in range(TRIES * POSTURES):
        drawn = rng.standard_normal((1, belief.robot.n, COEFFICIENTS + 2))
        drawn[..., COEFFICIENTS] = rng.uniform(size=(1, belief.robot.n))
        if attempt and attempt % POSTURES == 0:
            size *= GENTLER
        drawn[..., COEFFICIENTS + 1] = size
        still = [j for j in range(belief.robot.n) if j not in slow.moving]
        drawn[:, still, :COEFFICIENTS] = 0.0
        motion = placed(shapes, drawn, slow)
        # The amplitude in the result is that of the coefficients times what was found.
        fourier = {}
        for j in slow.moving:
            c = drawn[0, j, :COEFFICIENTS]
            y = c @ shapes.y
            amplitude = float(np.ptp(motion.q[0, :, j]) / np.ptp(y))
            fourier[names[j]] = FourierMotion(
                centre=float(motion.q[0, 0, j]),
                sine=(amplitude * c[0::2]).tolist(),
                cosine=(amplitude * c[1::2]).tolist(),
            )
        move = PlannedMove(
            name="drive_slow",
            stage="",
            joints=list(fourier),
            duration_s=SLOW_S,
            start=_start(belief, motion.q[0, 0]),
            fourier=fourier,
        )
        if _is_free(belief, move):
            return move
    raise _nothing_free(belief, "slow motion")


def _steps(belief: Belief, postures: Array, j: int) -> PlannedMove:
    """Return steps of one joint, with a hold behind each, in the first free posture."""
    limits = belief.limits
    name = belief.robot.joint_names[j]
    crawl = CRAWL_SHARE * limits.range[j]
    for attempt in range(TRIES):
        gentler = GENTLER**attempt
        speed = float(gentler * limits.speed[j])
        acceleration = float(gentler**2 * limits.acceleration[j])
        largest = max(STEP_SHARES) * gentler * limits.range[j]
        for drawn in postures:
            posture = drawn.copy()
            posture[j] = np.clip(
                posture[j], limits.lower[j] + largest, limits.upper[j] - 2.0 * largest
            )
            place = float(posture[j])
            strokes = []
            for share in STEP_SHARES:
                step = float(share * gentler * limits.range[j])
                for way in (step, -step, -step, step):
                    # A short way ends before its speed is reached.
                    top = min(speed, float(np.sqrt(abs(way) * acceleration / np.pi)))
                    strokes.append(_stroke(place, place + way, top, acceleration))
                    place += way
                    strokes.append(
                        _stroke(place, place + crawl, crawl / HOLD_S, acceleration)
                    )
                    place += crawl
            move = PlannedMove(
                name=f"drive_steps_{name}",
                stage="",
                joints=[name],
                duration_s=seconds_of(strokes),
                start=_start(belief, posture),
                strokes=strokes,
            )
            if _is_free(belief, move):
                return move
    raise _nothing_free(belief, f"step of {name}")


def _stroke(start: float, end: float, speed: float, acceleration: float) -> Stroke:
    return Stroke(
        start=float(start),
        end=float(end),
        speed=float(speed),
        acceleration=float(acceleration),
    )
