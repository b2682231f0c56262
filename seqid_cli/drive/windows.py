"""A simulated robot against its logs, window by window.

Each window begins with the state that the log has there, so that errors of a window are
those that its own time makes. A window of a second is long against a loop: what a
simulator has wrong shows, and does not pile up.

Beside the closed loop stand guesses that need no model. The command at the best delay,
and the first position with the change of that command since then: where a joint sticks,
the second one is hard to beat.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from seqid_cli.drive.effects import ArmEffects, EffectTorque
from seqid_cli.drive.equations import INTEGRAL, PARTS, Delays
from seqid_cli.drive.integrals import stretch_means
from seqid_cli.drive.signals import (
    STANDS_S,
    STANDS_STEPS,
    DriveSignals,
    command_at,
    mean_command,
    slopes_at,
    table_for,
)
from seqid_cli.drive.simulation import STEP_S, Asked, ClosedLoop, Gains
from seqid_cli.effects.memory import deflection
from seqid_cli.logs.raw import Rows
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.params.results.drive import DriveFile, JointDrive
from seqid_cli.params.results.replay import (
    ReplayError,
    ReplayJoint,
    ReplayTrace,
    WorstWindow,
)
from seqid_cli.typing import Array, Mask

MOST_WINDOWS = 400  # in one run of the simulation: more take memory and save no time
# Steps of the delays that are tried for the trivial guesses, in samples.
DELAY_STEPS = 1
TRACE_POINTS = 200  # of what a report draws
# Of the simulated steps: after the arm has settled, how long, and how large.
STEP_AT_S = 1.0
STEP_LASTS_S = 1.0
STEP_SHARE = 0.1  # of the joint's travel in the logs
SHOWN_BEFORE_S = 0.1  # of what was before the step
# What a joint has that moves as it was measured.
NO_DRIVE = JointDrive(
    parameters=[], command="held", command_known=False, left=None, rmse=None, samples=0
)


@dataclass(frozen=True, kw_only=True)
class Window:
    """A stretch of a log: rows [start, stop)."""

    log: DriveSignals
    start: int
    stop: int


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """What all windows show, (W, R, n) for R rows of a window."""

    windows: Sequence[Window]
    position: Array  # simulated less measured, rad
    velocity: Array
    torque: Array | None  # N m
    open_position: Array | None  # by the measured torque
    step_s: float


def windows_of(
    logs: Sequence[DriveSignals], window_s: float, driven: Sequence[int]
) -> list[Window]:
    """Cut logs into windows in which every driven joint has everything."""
    windows = []
    for log in logs:
        rows = round(window_s * log.rate_hz)
        usable: Mask = np.asarray(log.usable[:, driven].all(axis=1))
        for start, stop in runs(usable, len(usable)):
            windows += [
                Window(log=log, start=first, stop=first + rows)
                for first in range(start, stop - rows, rows)
            ]
    return windows


def gains_of(file: DriveFile, names: Sequence[str]) -> Gains:
    """Return the controllers of a drive file in the order of joints."""
    joints = [file.joints.get(name, NO_DRIVE) for name in names]

    def column(parameter: str) -> Array:
        return np.array([joint.value(parameter) for joint in joints])

    def known(parameter: str, otherwise: float) -> Array:
        values = [joint.known(parameter) for joint in joints]
        return np.array(
            [otherwise if value is None else value for value in values], np.float64
        )

    return Gains(
        proportional=column("proportional"),
        derivative=column("derivative"),
        integral=column("integral"),
        velocity_feedforward=column("velocity_feedforward"),
        acceleration_feedforward=column("acceleration_feedforward"),
        gravity=column("gravity_compensation"),
        offset=np.array([joint.offset for joint in joints]),
        torque_limit=known("torque_limit", np.inf),
        velocity_limit=known("velocity_limit", np.inf),
        dead_band=column("dead_band"),
        armature=column("armature"),
        coulomb=column("coulomb"),
        viscous=column("viscous"),
        friction_factor=known("friction_factor", 1.0),
        stribeck=column("stribeck"),
        stribeck_speed=known("stribeck_speed", 1.0),
        load_friction=column("load_friction"),
    )


def closed_loop(
    file: DriveFile,
    model: TorqueModel,
    logs: Sequence[DriveSignals],
    effects: ArmEffects | None = None,
) -> ClosedLoop:
    """Build the simulation of an arm with its controllers, for the range of logs."""
    effects = effects or ArmEffects.none(model)
    tables = [
        table_for(surface, logs, j, effects.added_to_table(j))
        for j, surface in enumerate(model.surfaces)
    ]
    gains = gains_of(file, model.robot.joint_names)
    return ClosedLoop(
        model=model,
        gains=replace(gains, armature=gains.armature + effects.armature),
        friction=tables,
        effects=effects.of_steps(gains.load_friction),
    )


def replayed(
    loop: ClosedLoop, file: DriveFile, windows: Sequence[Window]
) -> list[Replayed]:
    """Simulate windows and compare them with their logs; one result for each rate."""
    by_rate: dict[float, list[Window]] = {}
    for window in windows:
        by_rate.setdefault(window.log.rate_hz, []).append(window)
    results = []
    for of_rate in by_rate.values():
        for first in range(0, len(of_rate), MOST_WINDOWS):
            results.append(_run(loop, file, of_rate[first : first + MOST_WINDOWS]))
    return results


def _run(loop: ClosedLoop, file: DriveFile, windows: Sequence[Window]) -> Replayed:
    """Simulate windows of one rate together."""
    rate_hz = windows[0].log.rate_hz
    per_row = max(1, int(np.ceil(1.0 / (rate_hz * STEP_S))))
    step_s = 1.0 / (rate_hz * per_row)
    rows = windows[0].stop - windows[0].start
    q0 = np.stack([window.log.q[window.start] for window in windows])
    v0 = np.stack([window.log.dq[window.start] for window in windows])
    integral = _first_integrals(file, windows)
    steps = (rows - 1) * per_row + 1
    asked = replace(
        _asked(file, windows, steps, step_s),
        celsius=_celsius(windows),
        bristles=[_bristles(each, windows) for each in loop.effects],
    )
    standing = np.array([_stands(window) for window in windows])
    simulated = loop.run(q0, v0, integral, asked, step_s, standing)

    measured = _rows(windows, "q")
    speed = _rows(windows, "dq")
    at_rows = slice(None, None, per_row)
    torque = None
    open_position = None
    if all(window.log.measured for window in windows):
        taus = _rows(windows, "torque")
        lagged = _late(file, loop, simulated.torque, step_s)
        torque = lagged[at_rows] - taus
        by_steps = _at_steps(windows, steps, step_s, per_row)
        open_run = loop.run_open(q0, v0, by_steps, step_s)
        open_position = _whole(open_run.q[at_rows] - measured)
    return Replayed(
        windows=windows,
        position=_whole(simulated.q[at_rows] - measured),
        velocity=_whole(simulated.dq[at_rows] - speed),
        torque=None if torque is None else _whole(torque),
        open_position=open_position,
        step_s=step_s,
    )


def _first_integrals(file: DriveFile, windows: Sequence[Window]) -> Array:
    """Return the integrals (B, n) [rad s] with which windows begin, by their logs."""
    begun = np.zeros((len(windows), len(file.robot.joints)))
    logs = {id(window.log): window.log for window in windows}
    for key, log in logs.items():
        of_log = [b for b, window in enumerate(windows) if id(window.log) == key]
        rows = np.array([windows[b].start for b in of_log])
        for j, name in enumerate(file.robot.joints):
            joint = file.joints.get(name, NO_DRIVE)
            if joint.value(INTEGRAL):
                begun[of_log, j] = _first_of_joint(joint, j, log, rows)
    return begun


def _first_of_joint(joint: JointDrive, j: int, log: DriveSignals, rows: Rows) -> Array:
    """Return the integral (K,) [rad s] of a joint at rows of a log."""
    gains = {part: joint.value(part) for part in PARTS}
    limit = joint.known("torque_limit")
    means = stretch_means(
        log,
        j,
        _course(joint, log),
        rows,
        [part for part in PARTS if part != INTEGRAL and gains[part]],
        Delays(command=joint.value("command_delay"), torque=joint.value("torque_lag")),
        torque_limit=np.inf if limit is None else limit,
        dead_band=joint.value("dead_band"),
    )
    return means.integrals(
        gains,
        offset=joint.offset,
        armature=joint.value("armature"),
        viscous=joint.value("viscous"),
        coulomb=joint.value("coulomb"),
    )


def _course(joint: JointDrive, log: DriveSignals) -> str:
    """Return what a joint's commands do between two stamps of a log."""
    return joint.command if joint.command in log.commands else "interpolated"


def _stands(window: Window) -> Mask:
    """Return which joints (n,) have stood still for a moment before a window."""
    log = window.log
    rows = max(1, round(STANDS_S * log.rate_hz))
    before = log.raw.q[max(0, window.start - rows) : window.start + 1]
    return np.asarray(np.ptp(before, axis=0) <= STANDS_STEPS * log.noise_step)


def _whole(errors: Array) -> Array:
    """Return errors (R, W, n) by window, (W, R, n)."""
    return np.ascontiguousarray(np.swapaxes(errors, 0, 1))


def _rows(windows: Sequence[Window], name: str) -> Array:
    """Return a channel of the logs in all windows, (R, W, n)."""
    parts = [getattr(w.log, name)[w.start : w.stop] for w in windows]
    return np.stack(parts, axis=1)


def _asked(
    file: DriveFile, windows: Sequence[Window], steps: int, step_s: float
) -> Asked:
    """Return what the controllers take for their command, delays in it."""
    shape = (steps, len(windows), windows[0].log.q.shape[1])
    c = np.zeros(shape)
    dc = np.zeros(shape)
    ddc = np.zeros(shape)
    names = list(file.robot.joints)
    for w, window in enumerate(windows):
        log = window.log
        t = log.raw.t[window.start] + np.arange(steps) * step_s
        for j, name in enumerate(names):
            joint = file.joints.get(name)
            if joint is None:
                continue
            at = t - joint.value("command_delay")
            c[:, w, j] = mean_command(log, joint.command, j, at, step_s)
            course = _course(joint, log)
            if joint.value("velocity_feedforward"):
                dc[:, w, j] = slopes_at(log, course, j, at)
            if joint.value("acceleration_feedforward"):
                ddc[:, w, j] = slopes_at(log, course, j, at, of="ddc")
    led = _led(file, windows, steps, step_s)
    return Asked(c=c, dc=dc, ddc=ddc, led=led)


def _celsius(windows: Sequence[Window]) -> Array | None:
    """Return temperatures (B, n) [degC] where windows begin; None without any."""
    logged = [window.log.raw.temperature for window in windows]
    if all(each is None for each in logged):
        return None
    unknown = np.full(windows[0].log.q.shape[1], np.nan)
    return np.stack(
        [
            unknown if celsius is None else celsius[window.start]
            for celsius, window in zip(logged, windows, strict=True)
        ]
    )


def _bristles(effect: EffectTorque, windows: Sequence[Window]) -> Array:
    """Return the deflection (B,) of bristles where windows begin, by the logs so far.

    It is zero for an effect that has none.
    """
    if effect.bristles is None:
        return np.zeros(len(windows))
    by_log = {
        id(window.log): deflection(
            window.log.q[:, effect.joint], effect.bristles.distance
        )
        for window in windows
    }
    return np.array([by_log[id(window.log)][window.start] for window in windows])


def _led(
    file: DriveFile, windows: Sequence[Window], steps: int, step_s: float
) -> Array | None:
    """Return the measured speeds of joints without a controller (T, B, n) [rad/s].

    Those of the others are not a number. None where every joint has a controller.
    """
    names = list(file.robot.joints)
    without = [j for j, name in enumerate(names) if name not in file.joints]
    if not without:
        return None
    led = np.full((steps, len(windows), len(names)), np.nan)
    splines = {
        id(window.log): CubicSpline(window.log.raw.t, window.log.q[:, without])
        for window in windows
    }
    for w, window in enumerate(windows):
        log = window.log
        t = log.raw.t[window.start] + np.arange(steps + 1) * step_s
        q = splines[id(log)](t)
        # A step ends where the log is, not only at its speed.
        led[:, w, without] = np.diff(q, axis=0) / step_s
    return led


def _late(file: DriveFile, loop: ClosedLoop, torque: Array, step_s: float) -> Array:
    """Return torques (T, B, n) as the log has them, late by each joint's lag."""
    late = torque.copy()
    for j, name in enumerate(loop.model.robot.joint_names):
        joint = file.joints.get(name, NO_DRIVE)
        steps = round(joint.value("torque_lag") / step_s)
        if steps > 0:
            late[steps:, :, j] = torque[:-steps, :, j]
            late[:steps, :, j] = torque[:1, :, j]
    return late


def _at_steps(
    windows: Sequence[Window], steps: int, step_s: float, per_row: int
) -> Array:
    """Return the measured torque between rows, (T, B, n)."""
    taus = _rows(windows, "torque")
    at = np.arange(steps) / per_row
    whole = np.minimum(at.astype(np.intp), len(taus) - 2)
    part = (at - whole)[:, None, None]
    return np.asarray(taus[whole] * (1.0 - part) + taus[whole + 1] * part)


def joints_of(
    file: DriveFile,
    results: Sequence[Replayed],
    steps: Mapping[str, ReplayTrace] = {},
) -> Mapping[str, ReplayJoint]:
    """Return the errors of each joint beside those of trivial guesses.

    `steps`: the joints' step responses.
    """
    joints = {}
    windows = [window for result in results for window in result.windows]
    for j, name in enumerate(file.robot.joints):
        if name not in file.joints:
            continue
        delay, delayed, changed = _guesses(file, windows, j)
        typical, worst = _traces(file, results, j)
        torque = None
        if all(result.torque is not None for result in results):
            torque = _error(
                windows,
                [
                    each[:, j]
                    for r in results
                    if r.torque is not None
                    for each in r.torque
                ],
            )
        without = None
        if all(result.open_position is not None for result in results):
            opened = [r.open_position for r in results if r.open_position is not None]
            without = _error(windows, [each[:, j] for one in opened for each in one])
        joints[name] = ReplayJoint(
            position=_error(
                windows, [each[:, j] for r in results for each in r.position]
            ),
            velocity=_error(
                windows, [each[:, j] for r in results for each in r.velocity]
            ),
            torque=torque,
            delayed_command=_error(windows, delayed),
            start_plus_change=_error(windows, changed),
            without_drive=without,
            baseline_delay_s=delay,
            typical_window=typical,
            worst_window=worst,
            step_response=steps.get(name),
        )
    return joints


def _error(windows: Sequence[Window], errors: Sequence[Array]) -> ReplayError:
    """Return the RMS over all windows, and the worst of them."""
    squares = np.array([float(np.mean(each**2)) for each in errors])
    worst = int(np.argmax(squares))
    window = windows[worst]
    return ReplayError(
        rms=float(np.sqrt(squares.mean())),
        worst=WorstWindow(
            log=str(window.log.path),
            start=float(window.log.raw.t[window.start]),
            rms=float(np.sqrt(squares[worst])),
        ),
    )


def _guesses(
    file: DriveFile, windows: Sequence[Window], joint: int
) -> tuple[float, list[Array], list[Array]]:
    """Return the best delay of the command, and the errors of both guesses with it."""
    course = file.joints[file.robot.joints[joint]].command

    def at(delay_s: float) -> tuple[list[Array], list[Array]]:
        delayed = []
        changed = []
        for window in windows:
            q = window.log.q[window.start : window.stop, joint]
            t = window.log.raw.t[window.start : window.stop]
            command = command_at(window.log, course, joint, t - delay_s)
            delayed.append(command - q)
            changed.append(q[0] + command - command[0] - q)
        return delayed, changed

    period_s = 1.0 / windows[0].log.rate_hz
    delays = np.arange(0.0, 0.5, DELAY_STEPS * period_s)
    costs = [float(np.mean(np.concatenate(at(delay)[1]) ** 2)) for delay in delays]
    best = float(delays[int(np.argmin(costs))])
    delayed, changed = at(best)
    return best, delayed, changed


def _traces(
    file: DriveFile, results: Sequence[Replayed], joint: int
) -> tuple[ReplayTrace, ReplayTrace]:
    """Return the positions of a joint where the error is the median, and the worst."""
    pairs = [
        (window, errors[:, joint])
        for result in results
        for window, errors in zip(result.windows, result.position, strict=True)
    ]
    pairs.sort(key=lambda pair: float(np.mean(pair[1] ** 2)))
    typical = _trace(file, joint, *pairs[len(pairs) // 2])
    return typical, _trace(file, joint, *pairs[-1])


def _trace(file: DriveFile, joint: int, window: Window, error: Array) -> ReplayTrace:
    """Return the positions of a joint in a window of errors (R,) [rad]."""
    every = max(1, len(error) // TRACE_POINTS)
    rows = np.arange(window.start, window.stop)[::every]
    t = window.log.raw.t[rows]
    measured = window.log.q[rows, joint]
    course = file.joints[file.robot.joints[joint]].command
    return ReplayTrace(
        t=t.tolist(),
        command=command_at(window.log, course, joint, t).tolist(),
        replayed=(measured + error[::every]).tolist(),
        measured=measured.tolist(),
    )


def step_responses(
    loop: ClosedLoop, file: DriveFile, windows: Sequence[Window]
) -> dict[str, ReplayTrace]:
    """Simulate a step of each joint's command, the others at rest where they are.

    The arm stands in the middle of the logs' positions. A joint holds there before the
    step: by an integral where its controller has one, else it sags as it must.
    """
    names = list(file.robot.joints)
    driven = [j for j, name in enumerate(names) if name in file.joints]
    q = np.concatenate([window.log.q[window.start : window.stop] for window in windows])
    middle = np.tile(np.median(q, axis=0), (len(driven), 1))
    count = round((STEP_AT_S + STEP_LASTS_S) / STEP_S)
    t = np.arange(count) * STEP_S
    c = np.broadcast_to(middle, (count, *middle.shape)).copy()
    sizes = []
    for b, j in enumerate(driven):
        travel = float(np.ptp(q[:, j]))
        sizes.append(STEP_SHARE * max(travel, 1e-3))
        delay = file.joints[names[j]].value("command_delay")
        c[t >= STEP_AT_S + delay, b, j] += sizes[b]
    nothing = np.zeros_like(c)
    rest = np.zeros_like(middle)
    led = None
    if len(driven) < len(names):
        led = np.full_like(c, np.nan)
        led[:, :, [j for j in range(len(names)) if j not in driven]] = 0.0
    asked = Asked(c=c, dc=nothing, ddc=nothing, led=led)
    run = loop.run(middle, rest, loop.integrals_at_rest(middle), asked, STEP_S)
    begin = round((STEP_AT_S - SHOWN_BEFORE_S) / STEP_S)
    shown = slice(begin, None, max(1, (count - begin) // TRACE_POINTS))
    traces = {}
    for b, j in enumerate(driven):
        command = np.where(t >= STEP_AT_S, sizes[b], 0.0)
        # By how much the joint goes on from where it has settled.
        before = run.q[round(STEP_AT_S / STEP_S) - 1, b, j]
        traces[names[j]] = ReplayTrace(
            t=(t[shown] - STEP_AT_S).tolist(),
            command=command[shown].tolist(),
            replayed=(run.q[shown, b, j] - before).tolist(),
        )
    return traces
