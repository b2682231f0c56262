"""Test of whether all logs are of one rigid body, naming a log or stretch that is not.

One least squares over logs of which some carry a tool gives the parameters of neither
arm, and a residual that still looks small against the torque. Here the logs are parted
into two groups with a rigid body each and one friction,

    e(G1, G2) = min over pi_1, pi_2, f of  sum_j ||R_j [pi_g; f; -1]||^2 / sigma_j^2,

R_j the triangular factor of joint j's equations in a log, sigma_j what the joint
leaves. The log that lowers e most by a body of its own goes first, others follow while
they lower it further. The two groups differ where that takes away most of what one body
leaves, where it is a fair share of the torque, and where no third group is left: if
every log wants a body of its own, the model is wrong, not a log.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from seqid_cli.identify.regression.least_squares import Accumulator, triangular
from seqid_cli.identify.settings import AgreementSettings
from seqid_cli.params.schema import Level, Verdict
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array

Group = list[int]
FEW_LOGS = 2  # up to which stretches of logs are compared, as one of them may stand out


@dataclass(frozen=True, kw_only=True)
class LogEquations:
    """The equations of one log, or of a stretch of one.

    `log`: its name. `part`: which of how many stretches; empty for a whole log.
    `factors` (n, p + 1, p + 1): triangular factor of each joint's [H y]. `samples`
    (n,): how many rows each of them has.
    """

    log: str
    part: str = ""
    factors: Array
    samples: Array

    @classmethod
    def of(cls, log: str, joints: Sequence[Accumulator]) -> "LogEquations":
        """Take the equations of a whole log."""
        totals = np.stack([joint.total for joint in joints])
        samples = np.array([joint.samples for joint in joints])
        return cls(log=PurePath(log).name, factors=totals, samples=samples)


def parts_of(
    log: str, joints: Sequence[Accumulator], *, parts: int = 4
) -> list[LogEquations]:
    """Cut a log's equations into stretches of about equal length, in their order."""
    name = PurePath(log).name
    stretches = []
    for k in range(parts):
        factors = []
        samples = []
        for joint in joints:
            first = len(joint.blocks) * k // parts
            last = len(joint.blocks) * (k + 1) // parts
            blocks = joint.blocks[first:last] or [np.zeros((1, joint.size + 1))]
            factors.append(triangular(np.vstack(blocks)))
            samples.append(sum(joint.rows[first:last]))
        stretches.append(
            LogEquations(
                log=name,
                part=f"part {k + 1} of {parts}",
                factors=np.stack(factors),
                samples=np.array(samples),
            )
        )
    return stretches


def log_equations(
    logs: Sequence[str], joints: Sequence[Sequence[Accumulator]]
) -> list[LogEquations]:
    """Return the equations of each log; few logs come in stretches.

    One stretch can then stand out.

    `joints` are the rows of each log's joints.
    """
    pairs = list(zip(logs, joints, strict=True))
    if len(pairs) > FEW_LOGS:
        return [LogEquations.of(log, log_joints) for log, log_joints in pairs]
    stretches: list[LogEquations] = []
    for log, log_joints in pairs:
        stretches += parts_of(log, log_joints)
    return stretches


@dataclass(frozen=True, kw_only=True)
class GroupedFit:
    """Weighted squares that G groups leave, and the parameters (G, p) of each."""

    squares: float
    theta: Array


class _Fit:
    """Weighted normal equations of each log.

    Parameters that are `rigid` may differ between groups.
    """

    def __init__(self, logs: Sequence[LogEquations], sigma: Array, rigid: int) -> None:
        self.rigid = rigid
        scaled = [log.factors / sigma[:, None, None] for log in logs]
        normals = np.array([np.einsum("jab,jac->bc", R, R) for R in scaled])
        # Columns of one size, so that one tolerance tells what the logs excite.
        size = np.sqrt(np.diagonal(normals.sum(axis=0))[:-1])
        self.scale = np.where(size > 0.0, size, np.inf)
        self.A = normals[:, :-1, :-1] / self.scale[:, None] / self.scale
        self.b = normals[:, :-1, -1] / self.scale
        self.squares = float(normals[:, -1, -1].sum())

    def solved(self, groups: Sequence[Group], *, rcond: float = 1e-9) -> GroupedFit:
        """Fit a rigid body to each group of logs, and one friction to all."""
        n_groups = len(groups)
        n_shared = self.A.shape[1] - self.rigid
        size = n_groups * self.rigid + n_shared
        shared = np.arange(n_groups * self.rigid, size)
        A = np.zeros((size, size))
        b = np.zeros(size)
        places = []
        for g, group in enumerate(groups):
            of_body = np.arange(g * self.rigid, (g + 1) * self.rigid)
            place = np.concatenate([of_body, shared])
            A[np.ix_(place, place)] += self.A[group].sum(axis=0)
            b[place] += self.b[group].sum(axis=0)
            places.append(place)
        theta = np.linalg.pinv(A, rcond=rcond, hermitian=True) @ b
        return GroupedFit(
            squares=max(self.squares - float(theta @ b), 0.0),
            theta=np.array([theta[place] / self.scale for place in places]),
        )


def agreement_verdicts(
    logs: Sequence[LogEquations],
    robot: Robot,
    sigma: Array,
    torque_squares: Array,
    rigid: int,
    settings: AgreementSettings = AgreementSettings(),
    *,
    independent: float = 1.0,
    max_third: float = 0.1,
    most_logs: int = 64,
) -> list[Verdict]:
    """Name the logs that are not of the same rigid body as the others.

    Parameters
    ----------
    logs : sequence of LogEquations
        Logs, or stretches of them, in their order.
    robot : Robot
        Names of the joints.
    sigma : ndarray, (n,)
        RMS residual [N m] of each joint when all logs are fitted together.
    torque_squares : ndarray, (n,)
        Squared torque of each joint, summed over its rows, (N m)^2.
    rigid : int
        How many of the first parameters are the rigid body's; the others are the same
        in all logs.
    independent : float
        Share of the rows that count as independent.
    settings : AgreementSettings
        When two groups differ, and from which share of a joint's torque that matters.
    max_third : float
        Share of what two groups take away that a third one may take, else no log stands
        out.
    most_logs : int
        Logs from which on nothing is compared: the cost grows with their square.

    Returns
    -------
    list of Verdict
        Empty where no log stands out.
    """
    if not 2 <= len(logs) <= most_logs:
        return []
    fit = _Fit(logs, np.maximum(sigma, 1e-12), rigid)
    all_logs = list(range(len(logs)))
    one_body = fit.solved([all_logs])
    groups = _two_groups(fit, all_logs)
    two_bodies = fit.solved(groups)

    # No chance, and no model that is wrong in every log.
    n_rows = independent * sum(float(log.samples.sum()) for log in logs)
    gain = one_body.squares - two_bodies.squares
    variance = max(two_bodies.squares / max(n_rows, 1.0), 1e-300)
    certainty = gain / rigid / variance
    gain_of_third = two_bodies.squares - _least_with_a_third(fit, groups)
    if certainty < settings.min_certainty or gain_of_third > max_third * gain:
        return []

    # Where it is seen: what each joint leaves by one body and by two.
    counts = np.maximum(sum(log.samples for log in logs), 1)
    with_one = _residual_norms(logs, [all_logs], one_body) / np.sqrt(counts)
    with_two = _residual_norms(logs, groups, two_bodies) / np.sqrt(counts)
    torque = np.sqrt(torque_squares / counts)
    differs = np.sqrt(np.maximum(with_one**2 - with_two**2, 0.0)) / np.maximum(
        torque, 1e-300
    )
    differs[with_two > settings.max_left * with_one] = 0.0
    worst = int(np.argmax(differs))
    if differs[worst] < settings.usable_share:
        return []
    joint = robot.joints[worst]
    reason = (
        f"{_named(logs, groups[1])}: one rigid body for all leaves"
        f" {with_one[worst]:.3g} {joint.unit('N m')} at {joint.name}"
        f" ({percent(differs[worst])} of its"
        f" torque), one for each leaves {with_two[worst]:.3g}. Is there a tool, a load"
        " or another mounting in one of them? Identify them apart; seqid diagnose"
        " tells what differs"
    )
    level: Level = "poor" if differs[worst] >= settings.poor_share else "usable"
    return [Verdict(good=False, level=level, reason=reason)]


def _named(logs: Sequence[LogEquations], odd: Group) -> str:
    """Say which logs, or parts of logs, differ from which."""
    others = [k for k in range(len(logs)) if k not in odd]
    split = {logs[k].log for k in odd} & {logs[k].log for k in others}
    odd_names = _names(logs, odd, split)
    other_names = _names(logs, others, split)

    verb = "differs" if len(odd_names) == 1 else "differ"
    from_what = "the others"
    if split and len({log.log for log in logs}) == 1:
        from_what = "the rest of the log"
    elif len(other_names) == 1 and not split:
        from_what = other_names[0]
    return f"{', '.join(odd_names)} {verb} from {from_what}"


def _names(logs: Sequence[LogEquations], group: Group, split: set[str]) -> list[str]:
    """Return the names of a group's logs, with their parts where a log is `split`."""
    parts: dict[str, list[str]] = {}
    for k in group:
        parts.setdefault(logs[k].log, []).append(logs[k].part)
    return [
        f"{log} ({', '.join(of_log)})" if log in split else log
        for log, of_log in parts.items()
    ]


def _two_groups(
    fit: _Fit, logs: Group, *, min_gain: float = 0.1
) -> tuple[Group, Group]:
    """Part logs into the many and the few that lower the squares most, few second.

    `min_gain`: share of the squares that are left by which one more log must lower
    them.
    """
    first = list(logs)
    second = Group()
    least = np.inf
    while len(first) > 1:
        squares_without = {}
        for k in first:
            remaining = [other for other in first if other != k]
            squares_without[k] = fit.solved([remaining, [*second, k]]).squares
        moved = min(squares_without, key=lambda k: (squares_without[k], k))
        if squares_without[moved] > (1.0 - min_gain) * least:
            break
        least = squares_without[moved]
        first = [k for k in first if k != moved]
        second = sorted([*second, moved])
    return (first, second) if len(second) <= len(first) else (second, first)


def _least_with_a_third(fit: _Fit, groups: tuple[Group, Group]) -> float:
    """Return the least squares that are left if one more log has a body of its own."""
    first, second = groups
    squares = [fit.solved([first, second]).squares]
    for group, other_group in ((first, second), (second, first)):
        if len(group) == 1:
            continue
        for k in group:
            remaining = [other for other in group if other != k]
            squares.append(fit.solved([remaining, other_group, [k]]).squares)
    return min(squares)


def _residual_norms(
    logs: Sequence[LogEquations], groups: Sequence[Group], fit: GroupedFit
) -> Array:
    """Return the root squares (n,) N m that each group's parameters leave at joints."""
    squares = np.zeros(len(logs[0].factors))
    for group, theta in zip(groups, fit.theta, strict=True):
        for k in group:
            residual = logs[k].factors @ np.append(theta, -1.0)
            squares += np.sum(residual**2, axis=1)
    return np.sqrt(squares)
