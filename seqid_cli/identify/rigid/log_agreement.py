"""Whether all logs are of one rigid body: a log, or a stretch of one, that stands out, by name.

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
    """Cut the equations of a log into stretches of about equal length, in their order."""
    name = PurePath(log).name
    found = []
    for k in range(parts):
        factors, samples = [], []
        for joint in joints:
            first, last = (len(joint.blocks) * edge // parts for edge in (k, k + 1))
            rows = joint.blocks[first:last] or [np.zeros((1, joint.size + 1))]
            factors.append(triangular(np.vstack(rows)))
            samples.append(sum(joint.rows[first:last]))
        found.append(
            LogEquations(
                log=name,
                part=f"part {k + 1} of {parts}",
                factors=np.stack(factors),
                samples=np.array(samples),
            )
        )
    return found


def log_equations(
    logs: Sequence[str], joints: Sequence[Sequence[Accumulator]], *, few: int = 2
) -> list[LogEquations]:
    """Take each log as a whole; `few` logs, or fewer, in stretches, so that one can stand out."""
    pairs = list(zip(logs, joints, strict=True))
    if len(pairs) > few:
        return [LogEquations.of(log, own) for log, own in pairs]
    return [part for log, own in pairs for part in parts_of(log, own)]


class _Fit:
    """Weighted normal equations of each log; `rigid` parameters may differ between groups."""

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

    def solved(
        self, groups: Sequence[Group], *, rcond: float = 1e-9
    ) -> tuple[float, Array]:
        """Return the weighted squares that groups leave, and parameters (G, p) of each."""
        count, rigid, shared = len(groups), self.rigid, self.A.shape[1] - self.rigid
        size = count * rigid + shared
        A, b = np.zeros((size, size)), np.zeros(size)
        places = []
        for g, group in enumerate(groups):
            own = np.arange(g * rigid, (g + 1) * rigid)
            place = np.concatenate([own, np.arange(count * rigid, size)])
            A[np.ix_(place, place)] += self.A[group].sum(axis=0)
            b[place] += self.b[group].sum(axis=0)
            places.append(place)
        theta = np.linalg.pinv(A, rcond=rcond, hermitian=True) @ b
        left = max(self.squares - float(theta @ b), 0.0)
        return left, np.array([theta[place] / self.scale for place in places])


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
    everything = list(range(len(logs)))
    before, (together,) = fit.solved([everything])
    first, second = _two_groups(fit, everything)
    after, apart = fit.solved([first, second])

    # No chance, and no model that is wrong in every log.
    rows = independent * sum(float(log.samples.sum()) for log in logs)
    certainty = (before - after) / rigid / max(after / max(rows, 1.0), 1e-300)
    third = after - _with_a_third(fit, first, second)
    if certainty < settings.min_certainty or third > max_third * (before - after):
        return []

    # Where it is seen: what each joint leaves by one body and by two.
    counts = np.maximum(sum(log.samples for log in logs), 1)
    with_one = _left(logs, [everything], [together]) / np.sqrt(counts)
    with_two = _left(logs, [first, second], apart) / np.sqrt(counts)
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
        f"{_named(logs, second)}: one rigid body for all leaves {with_one[worst]:.3g}"
        f" {joint.unit('N m')} at {joint.name} ({percent(differs[worst])} of its"
        f" torque), one for each leaves {with_two[worst]:.3g}. Is there a tool, a load"
        " or another mounting in one of them? Identify them apart; seqid diagnose"
        " tells what differs"
    )
    level: Level = "poor" if differs[worst] >= settings.poor_share else "usable"
    return [Verdict(good=False, level=level, reason=reason)]


def _named(logs: Sequence[LogEquations], odd: Group) -> str:
    """Say which logs, or parts of logs, differ from which."""
    other = [k for k in range(len(logs)) if k not in odd]
    split = {logs[k].log for k in odd} & {logs[k].log for k in other}
    names = []
    for group in (odd, other):
        found: dict[str, list[str]] = {}
        for k in group:
            found.setdefault(logs[k].log, []).append(logs[k].part)
        names.append(
            [
                f"{log} ({', '.join(own)})" if log in split else log
                for log, own in found.items()
            ]
        )
    verb = "differs" if len(names[0]) == 1 else "differ"
    others = names[1][0] if len(names[1]) == 1 and not split else "the others"
    if split and len({log.log for log in logs}) == 1:
        others = "the rest of the log"
    return f"{', '.join(names[0])} {verb} from {others}"


def _two_groups(
    fit: _Fit, logs: Group, *, min_gain: float = 0.1
) -> tuple[Group, Group]:
    """Part logs into the many and the few that lower the squares most; the few come second.

    `min_gain`: share of the squares that are left by which one more log must lower
    them.
    """
    first, second = list(logs), Group()
    least = np.inf
    while len(first) > 1:
        tries = [
            (fit.solved([[k for k in first if k != m], [*second, m]])[0], m)
            for m in first
        ]
        left, moved = min(tries)
        if left > (1.0 - min_gain) * least:
            break
        least = left
        first, second = [k for k in first if k != moved], sorted([*second, moved])
    return (first, second) if len(second) <= len(first) else (second, first)


def _with_a_third(fit: _Fit, first: Group, second: Group) -> float:
    """Return the least squares that are left if one more log has a body of its own."""
    tries = [fit.solved([first, second])[0]]
    for group, other in ((first, second), (second, first)):
        for one in group if len(group) > 1 else []:
            rest = [k for k in group if k != one]
            tries.append(fit.solved([rest, other, [one]])[0])
    return min(tries)


def _left(
    logs: Sequence[LogEquations],
    groups: Sequence[Group],
    theta: Sequence[Array] | Array,
) -> Array:
    """Root of the squares (n,) that parameters of each group leave at each joint, N m."""
    squares = np.zeros(len(logs[0].factors))
    for group, own in zip(groups, theta, strict=True):
        for k in group:
            squares += np.sum((logs[k].factors @ np.append(own, -1.0)) ** 2, axis=1)
    return np.sqrt(squares)
