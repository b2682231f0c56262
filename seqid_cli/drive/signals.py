"""One log as the fit of a controller sees it: all channels through the same low-pass.

A controller computes its torque from command and position by a linear law, and a
low-pass of all of them leaves the law as it is. The encoder's noise is no error here:
the controller has seen the same noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline

from seqid_cli.drive.effects import ArmEffects
from seqid_cli.drive.friction_table import AddedFriction, FrictionTable
from seqid_cli.logs.raw import Rows
from seqid_cli.logs.recording import CommandForm, Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.motion.filters.survey import survey_of_positions
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.segmentation import moving_mask
from seqid_cli.typing import Array, Mask

# Samples per period of the cut-off: fewer do not give velocities by differences.
SAMPLES_PER_PERIOD = 10.0


# The cut-off is not higher than this, above which torque is mostly noise.
HIGHEST_HZ = 25.0
# Samples about a place from which values there are interpolated: with fewer a delay
# would damp what is at the upper end of the band.
KNOTS = np.arange(-3, 5)
# Beyond the positions and speeds of the log, as a share of them, to which friction is
# tabled: a simulated joint overshoots where the real one did not.
MARGIN = 0.2
# Delays of commands that step are told apart by so many digits of a second.
DELAY_DIGITS = 9
MOST_HELD = 200  # of these commands are kept: they take memory
# A joint stands that has moved by less than so many steps of its encoder for so long.
STANDS_S = 0.1
STANDS_STEPS = 1.5


@dataclass(frozen=True, kw_only=True)
class Command:
    """A commanded position as the controller may have taken it, low-passed."""

    c: Array  # (N, n) rad
    dc: Array  # (N, n) rad/s
    ddc: Array  # (N, n) rad/s^2


@dataclass(frozen=True, kw_only=True)
class DriveSignals:
    """One log, N samples of n joints on a uniform time base.

    Attributes
    ----------
    q, dq, ddq : (N, n) arrays
        rad, rad/s, rad/s^2.
    torque : (N, n) array
        N m, the measured torque, or what the model computes from the motion.
    measured : bool
        Which of the two.
    gravity : (N, n) array
        N m, by the model.
    commands : dict of str to Command
        By how the controller takes them between two stamps: "held" or "interpolated".
    sent : (times, values), optional
        When each command was sent [s], and the commands (K, n), where rows are faster.
    usable : (N, n) mask
        Samples with all of it.
    moving : (N, n) mask
    command_period_s : float
        Time between two commands.
    noise_step : (n,) array
        rad, that a position jumps by at rest.
    raw : Recording
        The log itself.
    """

    path: Path
    rate_hz: float
    cutoff_hz: float
    q: Array
    dq: Array
    ddq: Array
    torque: Array
    measured: bool
    gravity: Array
    commands: dict[str, Command]
    sent: tuple[Array, Array] | None
    usable: Mask
    moving: Mask
    command_form: CommandForm
    command_period_s: float
    noise_step: Array
    raw: Recording
    # What commands that step do, low-passed, by joint and delay.
    held: dict[tuple[str, int, float], Array] = field(default_factory=dict, repr=False)
    # Curves through rows, by what they are of and joint: a simulation asks for them at
    # every delay that it tries.
    curves: dict[tuple[str, int], Callable[[Array], Array]] = field(
        default_factory=dict, repr=False
    )

    def command_steps(self, joint: int) -> tuple[Array, Array]:
        """Return when a joint's commands were sent (K,) [s], and these (K,) [rad]."""
        if self.sent is not None:
            times, values = self.sent
            return times, values[:, joint]
        assert self.raw.command is not None
        present = np.isfinite(self.raw.command[:, joint])
        return self.raw.t[present], self.raw.command[present, joint]


def signals_of(
    log: Recording,
    model: TorqueModel,
    *,
    cutoff_hz: float | None = None,
    use_torque: bool = True,
    share: float = 1.0,
    effects: ArmEffects | None = None,
) -> DriveSignals:
    """Filter a log.

    Parameters
    ----------
    log : Recording
        With commanded positions.
    model : TorqueModel
        The arm.
    cutoff_hz : float, optional
        The cut-off; chosen from the log where it is left out.
    use_torque : bool
        Whether a measured torque counts.
    share : float
        Of the cut-off that is taken, to see what the choice does to a fit.
    effects : ArmEffects, optional
        What the arm's file has beside its model.
    """
    assert log.command is not None
    rate_hz = log.rate_hz
    measured = use_torque and log.tau is not None
    survey = survey_of_positions(log.q, rate_hz)
    resolution = encoder_resolution(model.robot)
    if cutoff_hz is None:
        cutoff_hz = min(HIGHEST_HZ, rate_hz / SAMPLES_PER_PERIOD)
        if not measured:
            # The motion has to give accelerations, which noise limits.
            cutoff_hz = min(cutoff_hz, survey.cutoff(resolution).hz)
    lowpass = Lowpass(cutoff_hz * share, rate_hz)

    q = lowpass(log.q, log.valid)
    dq, ddq = differentiate(q, rate_hz, log.valid)
    if measured and log.tau is not None:
        torque = lowpass(log.tau, log.valid)
    else:
        friction = lowpass(model.friction(q, dq), log.valid)
        torque = model.rigid(q, dq, ddq) + friction
        if effects is not None:
            added = lowpass(effects.along(q, dq, torque - friction), log.valid)
            torque = torque + added + effects.armature * ddq

    has_command = np.isfinite(log.command)
    settled = shrink(log.valid, 2 * lowpass.settling)
    usable = np.stack(
        [shrink(column, 2 * lowpass.settling) & settled for column in has_command.T],
        axis=1,
    )
    sent = sent_commands(log)
    return DriveSignals(
        path=log.path,
        rate_hz=rate_hz,
        cutoff_hz=lowpass.cutoff_hz,
        q=q,
        dq=dq,
        ddq=ddq,
        torque=torque,
        measured=measured,
        gravity=model.rigid(q, np.zeros_like(q), np.zeros_like(q)),
        commands={
            name: _filtered(values, lowpass, log.valid)
            for name, values in _courses(log, sent).items()
        },
        sent=sent,
        usable=usable,
        moving=moving_mask(log.q, rate_hz, survey.noise_step(resolution)),
        command_form=log.command_form,
        command_period_s=(
            1.0 / rate_hz
            if sent is None
            else float(np.quantile(np.diff(sent[0]), 0.25))
        ),
        noise_step=np.broadcast_to(survey.noise_step(resolution), log.q.shape[1:]),
        raw=log,
    )


def _filtered(command: Array, lowpass: Lowpass, valid: Mask) -> Command:
    c = lowpass(_filled(command), valid)
    dc, ddc = differentiate(c, lowpass.rate_hz, valid)
    return Command(c=c, dc=dc, ddc=ddc)


def _filled(values: Array) -> Array:
    """Return values (N, n), what is missing as the nearest one that is not."""
    filled = values.copy()
    rows = np.arange(len(values), dtype=np.float64)
    for column in filled.T:
        present = np.isfinite(column)
        if not present.any():
            column[:] = 0.0
        elif not present.all():
            column[:] = np.interp(rows, rows[present], column[present])
    return filled


def sent_commands(log: Recording) -> tuple[Array, Array] | None:
    """Return when commands were sent (K,) [s], and these (K, n).

    None where each row has its own.
    """
    if log.command_form == "sampled" or log.command is None:
        return None
    rows = _sent_rows(log)
    if len(rows) < 2:
        return None
    return _sent_times(log, rows), _filled(log.command[rows])


def _sent_rows(log: Recording) -> Rows:
    """Return the rows in which a new command is there first."""
    assert log.command is not None
    if log.command_age is not None:
        # A new one is younger than the time since the row before.
        age = log.command_age
        fresh = np.isfinite(age) & (age < (1.0 - 1e-6) / log.rate_hz)
        return np.flatnonzero(fresh)
    changes = np.diff(log.command, axis=0)
    return np.flatnonzero((np.nan_to_num(changes) != 0.0).any(axis=1)) + 1


def _sent_times(log: Recording, rows: Rows) -> Array:
    """Return when the commands of some rows were sent, as well as stamps tell [s]."""
    if log.command_age is not None:
        return np.asarray(log.t[rows] - log.command_age[rows])
    return np.asarray(log.t[rows])


def _courses(log: Recording, commands: tuple[Array, Array] | None) -> dict[str, Array]:
    """Return the command (N, n) as it may run between two stamps, by name."""
    assert log.command is not None
    if commands is None:
        courses = {"interpolated": log.command}
        if log.command_form != "sampled":
            # It does not change: both are one.
            courses = {"held": log.command} | courses
        return courses
    times, sent = commands
    lines = np.stack([np.interp(log.t, times, column) for column in sent.T], axis=1)
    present = np.isfinite(log.command)
    return {
        "held": log.command,
        "interpolated": np.where(present, lines, np.nan),
    }


def command_at(log: DriveSignals, course: str, joint: int, t: Array) -> Array:
    """Return a joint's command (K,) at some times, as it runs between two stamps."""
    times, column = log.command_steps(joint)
    if course == "held":
        # A stamp that lies on a row is rounded.
        latest = np.searchsorted(times, t + 1e-6 / log.rate_hz, side="right") - 1
        return np.asarray(column[np.maximum(latest, 0)])
    if log.sent is None and len(times) > 2:
        # Samples of a smooth command: chords would be short of every bend.
        key = ("command", joint)
        if key not in log.curves:
            log.curves[key] = Akima1DInterpolator(times, column, method="makima")
        curve = log.curves[key]
        return np.asarray(curve(np.clip(t, times[0], times[-1])), np.float64)
    return np.interp(t, times, column)


def slopes_at(
    log: DriveSignals,
    course: str,
    joint: int,
    t: Array,
    *,
    of: Literal["dc", "ddc"] = "dc",
) -> Array:
    """Return the velocity or acceleration (K,) of a joint's command at some times.

    Times are those of one window: of a command that is missing now and then the
    stretch counts that is nearest to them. Chords between rows would be short of waves:
    0.1 % at a fiftieth of the rows' rate.
    """
    key = (f"{of} {course}", joint)
    if key not in log.curves:
        values = getattr(log.commands[course], of)[:, joint]
        log.curves[key] = _CurveOfStretches(log.raw.t, values)
    return log.curves[key](t)


class _CurveOfStretches:
    """Cubic splines through rows at times (N,), one for each stretch without a gap."""

    def __init__(self, times: Array, values: Array) -> None:
        stretches = runs(np.isfinite(values), len(values))
        of_use = [(start, stop) for start, stop in stretches if stop - start > 1]
        self.ends = [(times[start], times[stop - 1]) for start, stop in of_use]
        self.curves = [
            CubicSpline(times[start:stop], values[start:stop]) for start, stop in of_use
        ]

    def __call__(self, t: Array) -> Array:
        """Return values (K,) at times (K,), held beyond the nearest stretch."""
        middle = 0.5 * float(t.min() + t.max())
        away = [max(first - middle, middle - last) for first, last in self.ends]
        nearest = int(np.argmin(away))
        held = np.clip(t, *self.ends[nearest])
        return np.asarray(self.curves[nearest](held), np.float64)


def beside_model(
    speed: Array,
    acceleration: Array,
    direction: Array,
    *,
    armature: Array | float,
    viscous: Array | float,
    coulomb: Array | float,
) -> Array:
    """Return the torque [N m] of rotors and friction that a model lacks.

    Parameters
    ----------
    speed, acceleration, direction : Array
        rad/s, rad/s^2, and the sign of the speed, of any shape.
    armature, viscous, coulomb : Array or float
        kg m^2, N m s/rad, N m, of a shape that goes with it.
    """
    of_friction = viscous * speed + coulomb * direction
    return np.asarray(armature * acceleration + of_friction)


def mean_command(
    log: DriveSignals, course: str, joint: int, t: Array, step_s: float
) -> Array:
    """Return a joint's mean command over the steps about some times [rad].

    A step that comes between two steps of a simulation counts by its share.
    """
    if course != "held":
        return command_at(log, course, joint, t)
    half = 0.5 * step_s
    later = sum_of_steps(log, joint, t + half)
    return np.asarray(later - sum_of_steps(log, joint, t - half)) / step_s


def sum_of_steps(log: DriveSignals, joint: int, t: Array) -> Array:
    """Return the integral over time of a joint's held command at some times [rad s]."""
    times, column = log.command_steps(joint)
    # The integral of what steps is a chain of straight lines.
    summed = np.concatenate([[0.0], np.cumsum(np.diff(times) * column[:-1])])
    before = column[0] * np.minimum(t - times[0], 0.0)
    after = column[-1] * np.maximum(t - times[-1], 0.0)
    return np.asarray(np.interp(t, times, summed) + before + after)


def delayed_sum(log: DriveSignals, joint: int, delay_s: float) -> Array:
    """Return the integral (N,) of a held command some time before, low-passed."""
    return _kept(log, "sum", joint, delay_s, sum_of_steps)


def delayed_command(
    log: DriveSignals, course: str, joint: int, delay_s: float
) -> Array:
    """Return a joint's command (N,) as it was some time before, low-passed.

    A command that steps is delayed before it is sampled and filtered: rows of the
    torque see a step when they come, not when it was.
    """
    if course != "held":
        return shifted(log.commands[course].c[:, joint], delay_s * log.rate_hz)
    return _kept(log, "step", joint, delay_s, _held_command)


def _held_command(log: DriveSignals, joint: int, t: Array) -> Array:
    return command_at(log, "held", joint, t)


def _kept(
    log: DriveSignals,
    kind: str,
    joint: int,
    delay_s: float,
    at: Callable[[DriveSignals, int, Array], Array],
) -> Array:
    """Return what a command does some time before, low-passed: a search asks often."""

    def computed() -> Array:
        sampled = at(log, joint, log.raw.t - delay_s)
        lowpass = Lowpass(log.cutoff_hz, log.rate_hz)
        return np.asarray(lowpass(sampled[:, None], log.raw.valid)[:, 0])

    return kept(log, (kind, joint, delay_s), computed)


def kept(
    log: DriveSignals, key: tuple[str, int, float], computed: Callable[[], Array]
) -> Array:
    """Return what was computed for a kind, a number and a delay [s], or compute it."""
    kind, number, delay_s = key
    rounded = (kind, number, round(delay_s, DELAY_DIGITS))
    if rounded not in log.held:
        if len(log.held) >= MOST_HELD:
            log.held.clear()
        log.held[rounded] = computed()
    return log.held[rounded]


def shifted(values: Array, samples: float) -> Array:
    """Return smooth values (N, ...) as they were some samples before, NaN at the ends.

    Between samples the polynomial through the `KNOTS` nearest is taken.
    """
    whole = int(np.floor(samples))
    # Sample k lies between samples k - whole - 1 and k - whole.
    place = 1.0 - (samples - whole)
    n = len(values)
    out = np.full_like(values, np.nan)
    first = max(0, whole + 1 - int(KNOTS[0]))
    stop = min(n, n + whole + 1 - int(KNOTS[-1]))
    if first >= stop:
        return out
    out[first:stop] = 0.0
    for knot in KNOTS:
        others = KNOTS[knot != KNOTS]
        weight = float(np.prod((place - others) / (knot - others)))
        start = first - whole - 1 + int(knot)
        out[first:stop] += weight * values[start : start + stop - first]
    return out


def courses_of_all(logs: Sequence[DriveSignals]) -> list[str]:
    """Return what commands may do between two stamps, by all logs."""
    return [
        course
        for course in logs[0].commands
        if all(course in log.commands for log in logs)
    ]


def table_for(
    surface: FrictionSurface | None,
    logs: Sequence[DriveSignals],
    joint: int,
    added: AddedFriction | None = None,
) -> FrictionTable:
    """Fill the table of a joint for the range of some logs, and a margin."""
    q = np.concatenate([log.q[:, joint] for log in logs])
    fastest = max(float(np.abs(log.dq[:, joint]).max()) for log in logs)
    margin = MARGIN * max(float(np.ptp(q)), 1e-3)
    return FrictionTable.of(
        surface,
        float(q.min()) - margin,
        float(q.max()) + margin,
        (1.0 + 2.0 * MARGIN) * max(fastest, 1e-3),
        added,
    )
