"""One arm of three joints by `seqid drive`, by CMA-ES, and by MuJoCo's own tool.

    python -m tests.studies.drive.peers [CPU_SECONDS]

All three see the same log: positions and commands in every row, no torque, and the true
links. They look for gains, delay, rotor and friction of each joint. CMA-ES (the package
`cma`) and `mujoco.sysid` (its least squares) compare rollouts of MuJoCo in windows of a
second with the log; each may take so many CPU seconds. What they find is judged by
rollouts of another log. A peer that is not installed is left out.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from mujoco import rollout
from scipy.signal import savgol_filter

from seqid_cli import drive as drives
from seqid_cli.logs.recording import Recording
from tests import Array
from tests.plants.driven import (
    DrivenArm,
    drawn_arm,
    mjcf_of,
    multisine,
    simulate_drive,
)

SEED = 700
HELD_OUT_SEED = 701
JOINTS = 3
SECONDS = 20.0
WINDOW_S = 1.0
STEP_S = 1e-3  # of rollouts in a search
JUDGING_STEP_S = 2.5e-4  # of those that judge: that of the arm itself
SETTLING_S = 1.5  # at either end of a log that is left out
NAMES = ("proportional", "derivative", "delay", "armature", "coulomb")
# What somebody would guess of any arm: the loop, rotors and friction.
GUESSED_HZ = 3.0
GUESSED_DAMPING = 0.7
GUESSED_DELAY_S = 0.02
GUESSED_ARMATURE = 0.05
GUESSED_COULOMB = 0.3
DEFAULT_CPU_S = 120.0
WIDE = 2.5  # of a logarithm, to either side of the guess: bounds
SIGMA = 0.5  # of a logarithm, where CMA-ES begins


@dataclass(frozen=True, kw_only=True)
class Found:
    """Numbers (5, n) in the order of `NAMES`, and what it took."""

    name: str
    values: Array
    cpu_s: float
    errors: Array | None = None  # (5, n), stated standard errors


class TimeUpError(Exception):
    """A search has taken what it may."""


@dataclass(frozen=True)
class Rollouts:
    """Windows of a log, simulated in MuJoCo."""

    arm: DrivenArm
    log: Recording
    step_s: float = STEP_S

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The arm with an actuator for each joint, whose numbers are set later."""
        text = mjcf_of(self.arm, step_s=self.step_s)
        joints = "".join(
            f'<general joint="joint_{j + 1}" biastype="affine"/>'
            for j in range(self.arm.robot.n)
        )
        text = text.replace(
            "</worldbody>", f"</worldbody><actuator>{joints}</actuator>"
        )
        return mujoco.MjModel.from_xml_string(text)

    @cached_property
    def starts(self) -> Array:
        """First rows of the windows."""
        rate_hz = self.log.rate_hz
        rows = round(WINDOW_S * rate_hz)
        skipped = round(SETTLING_S * rate_hz)
        return np.arange(skipped, len(self.log.t) - rows - skipped, rows)

    @cached_property
    def states(self) -> Array:
        """Full states (W, 1 + 2 n) where the windows begin."""
        step = 1.0 / self.log.rate_hz
        q = savgol_filter(self.log.q, 11, 4, axis=0)
        dq = savgol_filter(self.log.q, 11, 4, deriv=1, delta=step, axis=0)
        times = np.zeros((len(self.starts), 1))
        return np.hstack([times, q[self.starts], dq[self.starts]])

    def errors(self, values: Array) -> Array:
        """Return simulated less measured positions (W, R, n) [rad].

        `values` are numbers (5, n) in the order of `NAMES`.
        """
        kp, kd, delay, armature, coulomb = values
        model = self.model
        model.actuator_gainprm[:, 0] = kp
        model.actuator_biasprm[:, 1] = -kp
        model.actuator_biasprm[:, 2] = -kd
        model.dof_armature[:] = armature
        model.dof_frictionloss[:] = coulomb
        per_row = round(1.0 / (self.log.rate_hz * self.step_s))
        rows = round(WINDOW_S * self.log.rate_hz)
        steps = np.arange(rows * per_row) * self.step_s
        times = self.log.t[self.starts][:, None] + steps
        command = self.log.command
        assert command is not None
        control = np.stack(
            [
                np.interp(times - delay[j], self.log.t, command[:, j])
                for j in range(len(delay))
            ],
            axis=-1,
        )
        data = mujoco.MjData(model)
        state, _ = rollout.rollout(model, data, self.states, control)
        n = self.arm.robot.n
        simulated = state[:, per_row - 1 :: per_row, 1 : 1 + n]
        at = self.starts[:, None] + 1 + np.arange(rows)
        return np.asarray(np.nan_to_num(simulated, nan=1.0) - self.log.q[at])

    def rms(self, values: Array) -> float:
        """Return the RMS of all windows [rad]."""
        return float(np.sqrt(np.mean(self.errors(values) ** 2)))


def plain_arm() -> DrivenArm:
    """An arm whose controllers are proportional and damped, and nothing more."""
    drawn = drawn_arm(SEED, JOINTS)
    nothing = np.zeros(JOINTS)
    plain = drawn.with_drive(
        integral=nothing, velocity_feedforward=nothing, gravity_compensation=nothing
    )
    return replace(plain, robot=replace(plain.robot, nominal=plain.phi))


def true_values(arm: DrivenArm) -> Array:
    """Viscous friction is damping here, for no log tells them apart."""
    drive = arm.drive
    delay = np.full(arm.robot.n, drive.command_delay)
    damping = drive.derivative + arm.viscous
    return np.stack([drive.proportional, damping, delay, arm.armature, arm.coulomb])


def guessed_values(rollouts: Rollouts) -> Array:
    """Return where both peers begin."""
    model = rollouts.model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    inertia = np.diag(M) - model.dof_armature + GUESSED_ARMATURE
    rate = 2.0 * np.pi * GUESSED_HZ
    ones = np.ones(model.nv)
    return np.stack(
        [
            inertia * rate**2,
            2.0 * GUESSED_DAMPING * inertia * rate,
            GUESSED_DELAY_S * ones,
            GUESSED_ARMATURE * ones,
            GUESSED_COULOMB * ones,
        ]
    )


def by_seqid(arm: DrivenArm, log: Recording) -> Found:
    """Run `seqid drive` without a model but the links."""
    start_s = time.process_time()
    file = drives.drive([log], arm.robot, (), drives.DriveOptions(no_torque=True))
    cpu_s = time.process_time() - start_s
    names = ("proportional", "derivative", "command_delay", "armature", "coulomb")
    values = np.empty((len(NAMES), arm.robot.n))
    errors = np.empty_like(values)
    for j, joint in enumerate(file.joints.values()):
        by_name = {each.name: each for each in joint.parameters}
        values[:, j] = [by_name[name].value for name in names]
        errors[:, j] = [by_name[name].std_error for name in names]
    return Found(name="seqid drive", values=values, cpu_s=cpu_s, errors=errors)


def _limited(
    rollouts: Rollouts, guess: Array, cpu_s: float
) -> Callable[[Array], Array]:
    """Return errors as a function of logarithms of numbers, until time is up."""
    until_s = time.process_time() + cpu_s

    def errors(x: Array) -> Array:
        if time.process_time() > until_s:
            raise TimeUpError
        values = guess * np.exp(np.clip(np.ravel(x), -WIDE, WIDE).reshape(guess.shape))
        return rollouts.errors(values).ravel()

    return errors


def by_cma(rollouts: Rollouts, cpu_s: float) -> Found | None:
    """Search by CMA-ES over logarithms; None where the package is missing."""
    try:
        import cma  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        return None
    guess = guessed_values(rollouts)
    errors = _limited(rollouts, guess, cpu_s)
    start_s = time.process_time()
    options = {"verbose": -9, "seed": 1, "bounds": [-WIDE, WIDE]}
    search = cma.CMAEvolutionStrategy(np.zeros(guess.size), SIGMA, options)
    try:
        while not search.stop():
            candidates = search.ask()
            costs = [float(np.mean(errors(each) ** 2)) for each in candidates]
            search.tell(candidates, costs)
    except TimeUpError:
        pass
    best = np.asarray(search.best.x).reshape(guess.shape)
    return Found(
        name="CMA-ES",
        values=guess * np.exp(best),
        cpu_s=time.process_time() - start_s,
    )


def by_mujoco(rollouts: Rollouts, cpu_s: float) -> Found | None:
    """Search by MuJoCo's least squares; None where the tool's extras are missing."""
    try:
        from mujoco.sysid import (
            Parameter,
            ParameterDict,
            calculate_intervals,
            optimize,
        )
    except ImportError:
        return None
    guess = guessed_values(rollouts)
    errors = _limited(rollouts, guess, cpu_s)
    n = guess.shape[1]
    zero = np.zeros(n)
    params = ParameterDict(
        {name: Parameter(name, zero, zero - WIDE, zero + WIDE) for name in NAMES}
    )
    best = [np.inf, params.as_vector()]

    def residual(
        x: Array, _: object, **more: object
    ) -> tuple[list[Array], object, object]:
        columns = np.asarray(x)
        if columns.ndim == 2 and columns.shape[1] > 1:
            parts = [errors(column) for column in columns.T]
            return [np.stack(parts, axis=1)], None, None
        off = errors(columns)
        cost = float(off @ off)
        if cost < best[0]:
            best[:] = [cost, columns.ravel().copy()]
        return [off.reshape(-1, 1) if columns.ndim == 2 else off], None, None

    start_s = time.process_time()
    stated = None
    try:
        _, result = optimize(params, residual, verbose=False, max_iters=100)
        spent_s = time.process_time() - start_s
        x = np.asarray(result.x).ravel()
        off = rollouts.errors(guess * np.exp(x.reshape(guess.shape))).ravel()
        _, intervals = calculate_intervals([off], np.asarray(result.jac))
        values = guess * np.exp(x.reshape(guess.shape))
        stated = values * np.asarray(intervals).reshape(guess.shape) / 1.96
    except TimeUpError:
        spent_s = time.process_time() - start_s
        values = guess * np.exp(np.asarray(best[1]).reshape(guess.shape))
    return Found(name="mujoco.sysid", values=values, cpu_s=spent_s, errors=stated)


def table(found: Sequence[Found], arm: DrivenArm, held_out: Rollouts) -> str:
    """Write how far each is off, and how well it moves the arm of another log."""
    true = true_values(arm)
    of_true = held_out.rms(true)
    lines = [
        f"held-out replay over {WINDOW_S:g} s by the true numbers: {of_true:.3g} rad"
    ]
    for each in found:
        off = np.abs(each.values / true - 1.0)
        by_name = ", ".join(
            f"{name} {np.median(row):.2%}" for name, row in zip(NAMES, off, strict=True)
        )
        stated = "no error stated"
        if each.errors is not None:
            holds = np.abs(each.values - true) <= 1.96 * each.errors
            stated = f"{int(holds.sum())} of {holds.size} in their 95 % interval"
        ratio = held_out.rms(each.values) / of_true
        lines.append(
            f"{each.name}: {each.cpu_s:.0f} CPU s; off by (median) {by_name}; worst"
            f" {off.max():.1%}; {stated}; held-out replay {ratio:.2f} of that of the"
            " true numbers"
        )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str]) -> None:
    cpu_s = float(arguments[0]) if arguments else DEFAULT_CPU_S
    arm = plain_arm()
    log, other = (
        simulate_drive(
            arm,
            multisine(seed, JOINTS, SECONDS),
            SECONDS,
            seed=seed,
            with_torque=False,
        )
        for seed in (SEED, HELD_OUT_SEED)
    )
    rollouts = Rollouts(arm, log)
    found = [
        by_seqid(arm, log),
        by_mujoco(rollouts, cpu_s),
        by_cma(rollouts, cpu_s),
    ]
    held_out = Rollouts(arm, other, JUDGING_STEP_S)
    present = [each for each in found if each is not None]
    sys.stdout.write(table(present, arm, held_out))


if __name__ == "__main__":
    main(sys.argv[1:])
