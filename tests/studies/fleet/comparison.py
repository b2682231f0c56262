"""Which robots of a fleet are unlike the others.

Every robot of one type has the same parameters, up to what making and wear let them differ by. A
parameter x_i of robot i with standard error s_i is taken to scatter about the fleet's as

    x_i ~ N(m, tau^2 + s_i^2),

with the median m and the spread tau^2 = max(0, S^2 - median(s_i^2)), where S is the scaled median
absolute deviation: robots that are far off change neither. The robust z-score

    z_i = (x_i - m) / sqrt(tau^2 + s_i^2)

says how unlike the fleet a robot is. It is held against a limit that all robots and parameters of
a healthy fleet together exceed with the probability `alpha`; because few robots tell their spread
badly, it is a quantile of Student's distribution with as many degrees of freedom as the median
absolute deviation of so many robots is worth (half of theirs, in simulation).

Friction is compared as the mean torque over the positions, at three speeds that all robots share.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from seqid_cli.errors import UsageError
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robust import gaussian_spread
from seqid_cli.trend.series import Quantity, quantities, speeds_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deviation:
    """How unlike its fleet one robot is in one quantity, in the quantity's unit."""

    robot: str
    quantity: Quantity
    value: float
    std_error: float
    fleet: float  # the median
    spread: float  # between healthy robots, standard errors taken off
    z: float
    drifts: bool


@dataclass(frozen=True)
class Fleet:
    """The comparison of a fleet's robots.

    `deviations` holds the most unlike quantity of every robot, the most unlike robot first; `limit`
    is the |z| from which on a robot drifts; `notes` say what could not be compared.
    """

    deviations: tuple[Deviation, ...]
    quantities: tuple[Quantity, ...]
    limit: float
    notes: tuple[str, ...]

    @property
    def drifting(self) -> tuple[str, ...]:
        """Names of the robots that drift."""
        return tuple(found.robot for found in self.deviations if found.drifts)


def judge_fleet(
    robots: Mapping[str, ParameterFile], *, alpha: float = 0.01, least_change: float = 0.01
) -> Fleet:
    """Compare the robots of a fleet with each other.

    Parameters
    ----------
    robots : mapping of name to ParameterFile
        Results of the same stages for robots of one type.
    alpha : float
        Probability that any robot of a healthy fleet is said to drift.

    Returns
    -------
    Fleet

    Raises
    ------
    UsageError
        There are too few robots, their joints differ, or they share no parameter.
    """
    _check(robots, alpha)
    names = list(robots)
    speeds = speeds_of(robots.values())
    tables = [dict(quantities(robots[name].stages, speeds)) for name in names]
    shared = [q for q in tables[0] if all(q in table for table in tables)]
    if not shared:
        raise UsageError(
            "the robots share no parameter", hint="Give results of the same stages for all."
        )
    values, errors = (
        np.array([[table[q][k] for q in shared] for table in tables]) for k in range(2)
    )
    limit = _limit(len(names), len(shared), alpha)
    center, spread, z = robust_scores(values, errors)
    size = np.maximum(np.abs(values), np.abs(center))
    drifts = (np.abs(z) > limit) & (np.abs(values - center) > least_change * size)
    # What drifts comes before what is merely odd.
    worst = np.argmax(np.abs(z) + np.where(drifts, 1e6, 0.0), axis=1)
    found = [
        Deviation(
            robot=name,
            quantity=shared[k],
            value=float(values[i, k]),
            std_error=float(errors[i, k]),
            fleet=float(center[k]),
            spread=float(spread[k]),
            z=float(z[i, k]),
            drifts=bool(drifts[i, k]),
        )
        for i, (name, k) in enumerate(zip(names, worst.tolist(), strict=True))
    ]
    found.sort(key=lambda one: (not one.drifts, -abs(one.z)))
    return Fleet(tuple(found), tuple(shared), limit, tuple(_notes(names, tables, shared)))


def robust_scores(values: Array, errors: Array) -> tuple[Array, Array, Array]:
    """Median (P,), spread (P,) and robust z-scores (N, P) of values and standard errors (N, P)."""
    center = np.median(values, axis=0)
    scatter = gaussian_spread(values - center)
    spread = np.sqrt(np.maximum(scatter**2 - np.median(errors**2, axis=0), 0.0))
    total = np.sqrt(spread**2 + errors**2)
    off = values - center
    certain = np.where(off == 0.0, 0.0, np.copysign(np.inf, off))
    z = np.divide(off, total, out=certain, where=total > 0)
    return center, spread, z


def _limit(robots: int, quantities: int, alpha: float) -> float:
    """The |z| that any of a healthy fleet exceeds with probability `alpha`, at most."""
    freedom = max((robots - 1) / 2, 1.0)
    return float(stats.t.isf(alpha / (2 * robots * quantities), freedom))


def _check(robots: Mapping[str, ParameterFile], alpha: float, *, least_robots: int = 4) -> None:
    if len(robots) < least_robots:
        raise UsageError(
            f"{len(robots)} robots are no fleet to compare with, {least_robots} are",
            hint="Compare two results of one robot with seqid compare.",
        )
    if not 0.0 < alpha < 1.0:
        raise UsageError(f"a probability of {alpha} is not between 0 and 1")
    first = next(iter(robots))
    joints = robots[first].robot.joints
    for name, file in robots.items():
        if file.robot.joints != joints:
            raise UsageError(
                f"has the joints {', '.join(file.robot.joints)}, but {first} has "
                f"{', '.join(joints)}",
                where=name,
                hint="Compare robots of one type.",
            )


def _notes(
    names: list[str], tables: list[dict[Quantity, tuple[float, float]]], shared: list[Quantity]
) -> Iterator[str]:
    everything = dict.fromkeys(q for table in tables for q in table)
    for quantity in everything:
        lack = [n for n, table in zip(names, tables, strict=True) if quantity not in table]
        if lack:
            more = f" and {len(lack) - 3} more" if len(lack) > 3 else ""
            what = " ".join(filter(None, (quantity.stage, quantity.joint, quantity.name)))
            yield f"{what} is not compared, it is not known of {', '.join(lack[:3])}{more}"
