"""Base parameters: the combinations of standard parameters that the torque depends on.

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
_SNAP = 1e-9  # factors nearer to a whole number than this are that number


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
        stop = self._n_joints * PER_LINK
        return self.expression[:, stop - PER_LINK : stop]

    @property
    def _n_joints(self) -> int:
        return int(self.expression.shape[1] // (PER_LINK + 1))

    def terms(self, k: int) -> dict[str, float]:
        """Return base parameter `k` as factors of standard parameters.

        The one that names it comes first.
        """
        names = standard_names(self._n_joints)
        row = self.expression[k]
        factors = {names[c]: float(row[c]) for c in np.flatnonzero(np.abs(row) > _SNAP)}
        own_name = self.names[k]
        return {own_name: factors.pop(own_name), **factors}

    def expression_text(self, k: int) -> str:
        """Write base parameter `k` as text, say ``Izz_1 + 0.16*m_2 + 36*Ia_1``."""
        text = ""
        for name, factor in self.terms(k).items():
            size = abs(factor)
            part = name if abs(size - 1.0) < _SNAP else f"{size:.6g}*{name}"
            if text:
                text += f" - {part}" if factor < 0 else f" + {part}"
            else:
                text = f"-{part}" if factor < 0 else part
        return text

    def unit(self, k: int) -> str:
        """Return the SI unit of base parameter `k`."""
        return parameter_unit(self.names[k])

    def joint_index(self, k: int) -> int:
        """Return the joint (0-based) that base parameter `k` is named after."""
        return int(self.names[k].rpartition("_")[2]) - 1


def parameter_unit(name: str) -> str:
    """Return the SI unit of a standard parameter, for example kg m of "mx_2"."""
    units = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m"}
    return units.get(name.rpartition("_")[0], "kg m^2")


def standard_names(n: int) -> tuple[str, ...]:
    """Name the 11 n standard parameters: link-major, then the rotor inertias."""
    links = tuple(f"{kind}_{i}" for i in range(1, n + 1) for kind in STANDARD)
    return links + tuple(f"{ROTOR}_{i}" for i in range(1, n + 1))


def gear_ratios(robot: Robot) -> Array:
    """Return each joint's gear ratio (n,), 1 where the robot file gives none."""
    return np.array([joint.gear_ratio or 1.0 for joint in robot.joints])


def standard_regressor(
    robot: Robot, q: Array, dq: Array, ddq: Array, *, coupling: Coupling
) -> Array:
    """Compute the regressor of the standard parameters (Eq. 3).

    Parameters
    ----------
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations [rad; m where prismatic].
    coupling : {"diagonal", "gyroscopic"}
        What a rotor loads; see `rotor_regressor`.

    Returns
    -------
    ndarray, (N, n, 11 n)
        Joint torques per unit of each parameter, rotors last.
    """
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

    Parameters
    ----------
    q, dq, ddq : ndarray, (N, n)
        Joint positions, velocities, accelerations [rad; m where prismatic].
    out : ndarray, (n, b or more, N or more), optional
        Written to, where `loaded_columns` tells that H can differ from zero; zeros
        elsewhere. More columns are the caller's.

    Returns
    -------
    ndarray, (N, n, b or more)
        Joint torques per unit of each parameter, each column contiguous in memory.
    """
    buffer = np.zeros((robot.n, basis.size, len(q))) if out is None else out
    H = buffer[:, :, : len(q)]
    if out is not None:
        H[:, : basis.size] = 0.0

    # Y is never formed: only the columns of it that P uses, link by link.
    P_links, P_rotors = np.split(basis.representative, [PER_LINK * robot.n])
    used = np.flatnonzero(P_links.any(axis=1)).tolist()
    kinds_by_link = regressor.columns_by_link(robot.n, used)
    blocks = regressor.link_blocks(
        robot.chain, robot.gravity, q, dq, ddq, kinds_by_link
    )
    for i, samples, block in blocks:
        for place, c in enumerate(PER_LINK * i + kinds_by_link[i]):
            for k in np.flatnonzero(P_links[c]):
                H[: i + 1, k, samples] += P_links[c, k] * block[:, place]

    ratio = gear_ratios(robot)
    for i, k in zip(*np.nonzero(P_rotors), strict=True):
        H[i, k] += ratio[i] ** 2 * ddq[:, i] * P_rotors[i, k]
    return H.transpose(2, 0, 1)


def gravity_base_regressor(robot: Robot, basis: Basis, q: Array) -> Array:
    """Compute the columns of the base regressor that last at rest (Eq. 17-19).

    Parameters
    ----------
    q : ndarray, (N, n)
        Joint positions [rad; m where prismatic].

    Returns
    -------
    ndarray, (N, n, g)
        H_g, the joint torques per unit of each gravity parameter.
    """
    g = int(basis.gravity.sum())
    of_gravity = Basis(
        names=basis.names[:g],
        expression=basis.expression[:g],
        representative=basis.representative[:, :g],
        gravity=basis.gravity[:g],
    )
    at_rest = np.zeros_like(q)
    return base_regressor(robot, of_gravity, q, at_rest, at_rest)


def loaded_columns(robot: Robot, basis: Basis) -> NDArray[np.bool_]:
    """Tell where (n, b) `base_regressor` can differ from zero.

    A parameter loads the joints up to the last link whose standard parameters give it.
    """
    joints = np.arange(robot.n)
    joint_of_standard = np.append(np.repeat(joints, PER_LINK), joints)
    is_used = basis.representative != 0.0
    last_joint: NDArray[np.intp] = np.where(
        is_used, joint_of_standard[:, None], -1
    ).max(axis=0)
    return joints[:, None] <= last_joint


@lru_cache(maxsize=8)
def base_parameters(
    robot: Robot, *, rotor: tuple[int, ...], zero: float = 1e-10
) -> Basis:
    """Find the base parameters of the rigid body and of the rotors to identify.

    Parameters
    ----------
    rotor : tuple of int
        Joints (0-based) whose rotor inertia is a parameter; that of the others is known
        and left out.
    zero : float
        Share of the largest column of the regressor below which a column is rounding.

    Returns
    -------
    Basis
        The parameters of the gravity torque come first.
    """
    W_gravity, W = _random_regressors(robot)
    of_links = _reading_order(robot.chain)
    of_rotors = [PER_LINK * robot.n + i for i in sorted(set(rotor))]
    used = of_links + of_rotors
    floor = zero * float(np.linalg.norm(W[:, : PER_LINK * robot.n], axis=0).max())

    # Independent columns of the gravity torque, then more of the whole torque.
    gravity = _independent(W_gravity, of_links, floor=floor)
    order = gravity + [c for c in used if c not in gravity]
    independent = _independent(W, order, floor=floor, n_taken=len(gravity))
    dynamic = sorted(set(independent) - set(gravity))
    base = gravity + dynamic

    # Gravity's parameters are those of the gravity torque alone, so that the columns of
    # the others vanish at rest.
    E_gravity = _regrouping(W_gravity, gravity, of_links, floor=floor)
    E_full = _regrouping(W, base, used, floor=floor)
    expression = np.vstack((E_gravity, E_full[len(gravity) :]))
    representative = np.zeros(expression.T.shape)
    for k, column in enumerate(base):
        representative[column, k] = 1.0
    representative[gravity, len(gravity) :] = -E_gravity[:, dynamic]

    names = standard_names(robot.n)
    return Basis(
        names=tuple(names[column] for column in base),
        expression=expression,
        representative=representative + 0.0,  # no negative zeros
        gravity=np.arange(len(expression)) < len(gravity),
    )


def free_basis(robot: Robot) -> Basis:
    """Return the base parameters with the rotor inertias that are not in the file."""
    rotor = tuple(j for j in range(robot.n) if robot.joints[j].rotor_inertia is None)
    return base_parameters(robot, rotor=rotor)


def _reading_order(chain: Chain) -> list[int]:
    """Return link columns in the order in which they are chosen.

    A link's own axis decides among its inertias: the one about the axis counts second.
    """
    order = []
    for i in range(chain.n):
        along = int(np.argmax(np.abs(chain.axis[i])))
        before, behind = [k for k in range(3) if k != along]
        first, second, third = ["xyz"[k] for k in (before, along, behind)]
        kinds = [
            *("mx", "my", "mz"),
            f"I{first}{first}",
            *("Ixy", "Ixz", "Iyz"),
            f"I{second}{second}",
            f"I{third}{third}",
            "m",
        ]
        order += [PER_LINK * i + STANDARD.index(kind) for kind in kinds]
    return order


def _random_regressors(robot: Robot) -> tuple[Array, Array]:
    """Stack the regressors of gravity and of all torque (rows, 11 n) at random states.

    Joint limits play no part: the torque is analytic in the state, so columns that
    depend linearly in one range do so in all, and a wide range shows it with the widest
    gap.
    """
    n = robot.n
    n_states = 3 * (PER_LINK + 1) * n
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, size=(3, n_states, n))
    q = q * np.where(robot.chain.prismatic, 1.0, np.pi)
    Y = standard_regressor(robot, q, 3.0 * dq, 10.0 * ddq, coupling="diagonal")
    Y_gravity = np.zeros_like(Y)
    Y_gravity[:, :, : PER_LINK * n] = regressor.gravity_regressor(
        robot.chain, robot.gravity, q
    )
    n_columns = Y.shape[2]
    return Y_gravity.reshape(-1, n_columns), Y.reshape(-1, n_columns)


def _independent(
    W: Array, order: Sequence[int], *, floor: float, n_taken: int = 0
) -> list[int]:
    """Choose columns of W, in an order, that do not depend on those before.

    Parameters
    ----------
    floor : float
        Norm of a column below which it is rounding, not torque.
    n_taken : int
        The first so many columns are taken without a test.
    """
    size = np.linalg.norm(W, axis=0)
    columns = [c for c in order if size[c] > floor]
    # The diagonal of R holds what each column has outside the span of those before.
    R = np.linalg.qr(W[:, columns] / size[columns], mode="r")
    outside = np.abs(np.diag(R))
    return [c for k, c in enumerate(columns) if k < n_taken or outside[k] > _DEPENDENT]


def _regrouping(
    W: Array, base: Sequence[int], used: Sequence[int], *, floor: float
) -> Array:
    """Solve W[:, base] E = W for E (b, p), on the `used` columns."""
    E = np.zeros((len(base), W.shape[1]))
    if not len(base):
        return E
    size = np.linalg.norm(W, axis=0)
    W_base = W[:, base]
    Q, R = np.linalg.qr(W_base / size[base])
    E[:, used] = np.linalg.solve(R, Q.T @ W[:, used]) / size[base][:, None]
    E[:, base] = np.eye(len(base))

    # Whole numbers are made exact, unless a column is then no longer explained.
    snapped = np.where(np.abs(E - np.round(E)) < _SNAP, np.round(E), E)
    misfit = np.linalg.norm(W_base @ snapped - W, axis=0)
    is_worse = misfit > _DEPENDENT * np.maximum(size, floor)
    return np.where(is_worse, E, snapped) + 0.0
