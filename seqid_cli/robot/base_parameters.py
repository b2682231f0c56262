"""Base parameters: the combinations of standard parameters that the joint torque depends on.

Symbols: phi (p,) standard parameters, 10 per link and then one rotor inertia per joint;
`pi` (b,) base parameters; E and P as in pi = E phi and Y P pi = Y phi, for every state.
Y is the regressor of Eq. 3, H = Y P that of Eq. 4. States `q`, `dq`, `ddq` (N, n) are
in rad, rad/s, rad/s^2 (m where prismatic).

Columns of Y are taken one by one in a readable order (first link first, a link's mass
last, rotors after all links); a column that depends on those before it is dropped and
its parameter regrouped into theirs. The order reproduces the usual regrouping towards
the base (Khalil and Dombre, Modeling, Identification and Control of Robots, ch. 9).
Columns of the gravity torque come first, and the coordinates are then changed so that
the gravity parameters are exactly those of the gravity torque alone (Eq. 17-18): the
remaining columns of H vanish at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from seqid_cli.robot import regressor
from seqid_cli.robot.regressor import PER_LINK, Coupling
from seqid_cli.robot.types import Array, Chain, Robot

STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
ROTOR = "Ia"

# A column is dependent where its part outside the span of the others is below this
# share of it. Geometry finer than 1e-5 rad or 1e-6 m is tidied away on reading, so the
# gap is wide.
_DEPENDENT = 1e-8
_SNAP = 1e-9


@dataclass(frozen=True)
class Basis:
    """Base parameters of one robot; a rotor acts on its own joint alone."""

    names: tuple[str, ...]  # the standard parameter that stands for each base parameter
    expression: Array  # E (b, p): base parameters from standard ones, p = 11 n
    # P (p, b): standard ones, most of them zero, that give the same torque
    representative: Array
    gravity: NDArray[np.bool_]  # (b,) those of the gravity torque; these come first

    @property
    def size(self) -> int:
        """Number of base parameters."""
        return len(self.names)

    @property
    def last_link(self) -> Array:
        """E_n (b, 10): base parameters from the standard ones of the last link."""
        links = self.expression.shape[1] // (PER_LINK + 1) * PER_LINK
        return self.expression[:, links - PER_LINK : links]

    def terms(self, k: int) -> dict[str, float]:
        """Return base parameter `k` as factors of standard ones, the one that names it first."""
        names = standard_names(self.expression.shape[1] // (PER_LINK + 1))
        row = self.expression[k]
        found = {names[c]: float(row[c]) for c in np.flatnonzero(np.abs(row) > _SNAP)}
        return {self.names[k]: found.pop(self.names[k]), **found}

    def expression_text(self, k: int) -> str:
        """Write base parameter `k` as text, for example ``Izz_1 + 0.16*m_2 + 36*Ia_1``."""
        text = ""
        for name, factor in self.terms(k).items():
            size, sign = abs(factor), "-" if factor < 0 else "+"
            part = name if abs(size - 1.0) < _SNAP else f"{size:.6g}*{name}"
            text = f"{text} {sign} {part}" if text else f"{'-' * (factor < 0)}{part}"
        return text

    def unit(self, k: int) -> str:
        """Return the SI unit of base parameter `k`."""
        return parameter_unit(self.names[k])

    def joint_index(self, k: int) -> int:
        """Return the joint (0-based) whose link or rotor base parameter `k` is named after."""
        return int(self.names[k].rpartition("_")[2]) - 1


def parameter_unit(name: str) -> str:
    """Return the SI unit of the standard parameter `name`, for example kg m of "mx_2"."""
    units = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m"}
    return units.get(name.rpartition("_")[0], "kg m^2")


def standard_names(n: int) -> tuple[str, ...]:
    """Name the 11 n standard parameters: link-major, then the motors' rotor inertias."""
    links = tuple(f"{kind}_{i}" for i in range(1, n + 1) for kind in STANDARD)
    return links + tuple(f"{ROTOR}_{i}" for i in range(1, n + 1))


def gear_ratios(robot: Robot) -> Array:
    """Return each joint's gear ratio (n,), 1 where the robot file gives none."""
    return np.array([joint.gear_ratio or 1.0 for joint in robot.joints])


def standard_regressor(
    robot: Robot, q: Array, dq: Array, ddq: Array, *, coupling: Coupling
) -> Array:
    """Compute the regressor (N, n, 11 n) of the standard parameters, rotors last (Eq. 3)."""
    Y = regressor.torque_regressor(robot.chain, robot.gravity, q, dq, ddq)
    rotors = regressor.rotor_regressor(
        robot.chain, q, dq, ddq, gear_ratios(robot), coupling
    )
    return np.concatenate((Y, rotors), axis=2)


def base_regressor(
    robot: Robot,
    basis: Basis,
    q: Array,
    dq: Array,
    ddq: Array,
    *,
    out: Array | None = None,
) -> Array:
    """Compute the regressor H = Y P of the base parameters (Eq. 4).

    `out` (n, b or more, M): written to, where `loaded_columns` tells that H can differ
    from zero; zeros elsewhere. More columns are the caller's. Returns (N, n, b or
    more): each column contiguous in memory.
    """
    whole = np.zeros((robot.n, basis.size, len(q))) if out is None else out
    H = whole[:, :, : len(q)]
    P, rotors = np.split(basis.representative, [PER_LINK * robot.n])
    kept = regressor.columns_by_link(robot.n, np.flatnonzero(P.any(axis=1)).tolist())
    if out is not None:
        H[:, : basis.size] = 0.0
    blocks = regressor.link_blocks(robot.chain, robot.gravity, q, dq, ddq, kept)
    for i, rows, block in blocks:
        for column, c in enumerate(PER_LINK * i + kept[i]):
            for k in np.flatnonzero(P[c]):
                H[: i + 1, k, rows] += P[c, k] * block[:, column]
    ratio = gear_ratios(robot)
    for i, k in zip(*np.nonzero(rotors), strict=True):
        H[i, k] += ratio[i] ** 2 * ddq[:, i] * rotors[i, k]
    return H.transpose(2, 0, 1)


def gravity_base_regressor(robot: Robot, basis: Basis, q: Array) -> Array:
    """Compute H_g (N, n, g): columns of the base regressor that last at rest (Eq. 17-19)."""
    own, still = int(basis.gravity.sum()), np.zeros_like(q)
    P, names = basis.representative[:, :own], basis.names[:own]
    alone = Basis(names, basis.expression[:own], P, basis.gravity[:own])
    return base_regressor(robot, alone, q, still, still)


def loaded_columns(robot: Robot, basis: Basis) -> NDArray[np.bool_]:
    """Say where (n, b) `base_regressor` can differ from zero: up to a parameter's last link."""
    used = basis.representative != 0.0
    last = np.append(np.repeat(np.arange(robot.n), PER_LINK), np.arange(robot.n))
    behind: NDArray[np.intp] = np.where(used, last[:, None], -1).max(axis=0)
    return np.arange(robot.n)[:, None] <= behind


@lru_cache(maxsize=8)
def base_parameters(
    robot: Robot, *, rotor: tuple[int, ...], zero: float = 1e-10
) -> Basis:
    """Find the base parameters of the rigid body and of the rotors to identify, gravity's first.

    `rotor`: joints (0-based) whose rotor inertia is a parameter; the others' are known,
    left out.
    """
    W_gravity, W = _random_regressors(robot)
    order = _reading_order(robot.chain)
    used = order + [PER_LINK * robot.n + i for i in sorted(set(rotor))]
    floor = zero * float(np.linalg.norm(W[:, : PER_LINK * robot.n], axis=0).max())
    gravity = _independent(W_gravity, order, floor=floor)
    rest = [c for c in used if c not in gravity]
    every = _independent(W, gravity + rest, floor=floor, given=len(gravity))
    others = sorted(set(every) - set(gravity))
    E_gravity = _regrouping(W_gravity, gravity, order, floor=floor)
    E_full = _regrouping(W, gravity + others, used, floor=floor)
    expression = np.vstack((E_gravity, E_full[len(gravity) :]))
    representative = np.zeros(expression.T.shape)
    for k, column in enumerate(gravity + others):
        representative[column, k] = 1.0
    representative[gravity, len(gravity) :] = -E_gravity[:, others]
    standard, of_gravity = (
        standard_names(robot.n),
        np.arange(len(expression)) < len(gravity),
    )
    names = tuple(standard[c] for c in gravity + others)
    return Basis(names, expression, representative + 0.0, of_gravity)


def free_basis(robot: Robot) -> Basis:
    """Return the base parameters with the rotor inertias that the robot file leaves open."""
    rotor = (j for j in range(robot.n) if robot.joints[j].rotor_inertia is None)
    return base_parameters(robot, rotor=tuple(rotor))


def _reading_order(chain: Chain) -> list[int]:
    """Order link columns for keeping; a link's own axis decides among its inertias."""
    order = []
    for i in range(chain.n):
        along = int(np.argmax(np.abs(chain.axis[i])))
        first, last = [k for k in range(3) if k != along]
        diagonal = [f"I{2 * 'xyz'[k]}" for k in (first, along, last)]
        kinds = ["mx", "my", "mz", diagonal[0], "Ixy", "Ixz", "Iyz", *diagonal[1:], "m"]
        order += [PER_LINK * i + STANDARD.index(kind) for kind in kinds]
    return order


def _random_regressors(robot: Robot) -> tuple[Array, Array]:
    """Stack gravity and full regressors (rows, 11 n) over random states."""
    # Joint limits play no part: the torque is analytic in the state, so columns that
    # depend linearly in one range do so in all, and a wide range shows it with the
    # widest gap.
    rng, n = np.random.default_rng(0), robot.n
    q, dq, ddq = rng.uniform(-1.0, 1.0, size=(3, 3 * (PER_LINK + 1) * n, n))
    q = q * np.where(robot.chain.prismatic, 1.0, np.pi)
    Y = standard_regressor(robot, q, 3.0 * dq, 10.0 * ddq, coupling="diagonal")
    Y_gravity = np.zeros_like(Y)
    Y_gravity[:, :, : PER_LINK * n] = regressor.gravity_regressor(
        robot.chain, robot.gravity, q
    )
    return Y_gravity.reshape(-1, Y.shape[2]), Y.reshape(-1, Y.shape[2])


def _independent(
    W: Array, order: Sequence[int], *, floor: float, given: int = 0
) -> list[int]:
    """Choose columns of W, in `order`, independent of those before; the first `given` are taken."""
    # Columns whose norm is below `floor` are rounding, not torque. The diagonal of R
    # holds what each column has outside the span of those before.
    size = np.linalg.norm(W, axis=0)
    columns = [c for c in order if size[c] > floor]
    outside = np.abs(np.diag(np.linalg.qr(W[:, columns] / size[columns], mode="r")))
    return [c for k, c in enumerate(columns) if k < given or outside[k] > _DEPENDENT]


def _regrouping(
    W: Array, kept: Sequence[int], used: Sequence[int], *, floor: float
) -> Array:
    """Solve W[:, kept] E = W for E (len(kept), p), on the `used` columns."""
    E = np.zeros((len(kept), W.shape[1]))
    if not len(kept):
        return E
    size = np.linalg.norm(W, axis=0)
    basis = W[:, kept]
    Q, R = np.linalg.qr(basis / size[kept])
    E[:, used] = np.linalg.solve(R, Q.T @ W[:, used]) / size[kept][:, None]
    E[:, kept] = np.eye(len(kept))
    snapped = np.where(np.abs(E - np.round(E)) < _SNAP, np.round(E), E)
    worse = np.linalg.norm(basis @ snapped - W, axis=0) > _DEPENDENT * np.maximum(
        size, floor
    )
    return np.where(worse, E, snapped) + 0.0
