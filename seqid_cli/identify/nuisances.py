"""What a drive adds to the logged torque, whatever the arm: one model for all stages.

A logged torque is late against the logged positions, has an offset, and friction is
larger one way than the other. With the torque `tau` that acts at joint j, its friction
f for motion forward, and s the direction of motion,

    tau_logged(t) = tau(t - d_j) + o_j + a_j |f_j(q, slow)| + b_j (|f_j| - |f_j(q,
    slow)|)
                    + e_j (T_j - T_0) f_j,

    d_j  delay [s]: a part common to all joints, of one logger's clock, and one of each
    joint's own, o_j  offset [N m], a_j  asymmetry, the share by which dry friction is
    larger forward than on the mean of both ways, b_j  viscous asymmetry, the same share
    of what friction has more at higher speeds, e_j  thermal change, the share by which
    friction grows per kelvin of the joint's temperature T_j
         above that of the trials, T_0, where temperatures are logged.

To first order a delay adds -d_j dtau/dt. All are unknowns of every stage, Gaussian
about zero with the standard deviations of `NuisancePriors`. Where logs do not show them
they are marginalised: the standard errors of everything else grow by what they may be.
Where logs do show them they are estimated, reported and taken along with their
covariance. No stage decides between them and the parameters that they resemble.

- Trials at constant speed, both ways: o and a |f| are the same both ways, as gravity
  is; the shape over the position tells them apart
  (`friction_surface.gravity_separation`, `rigid.gravity`). A delay turns with the
  direction, as friction does: -|v| d dG/dq (`friction_surface.reduction`).
- Moves of many joints: d is seen by dtau/dt (`rigid.inertia_equations`). What it says
  of friction goes back into the friction stage, whose entries are linear in it
  (`with_term`). So is friction per kelvin, by trials and moves at different
  temperatures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionJoint, Nuisance
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# A joint's terms that do not turn with its direction, in their order.
EVEN_NAMES = ("offset", "asymmetry", "viscous_asymmetry")
EVEN_TERMS = len(EVEN_NAMES)
DRIVE_NAMES = ("delay", *EVEN_NAMES, "thermal")
TERM_UNITS = {
    "delay": "s",
    "thermal": "1/K",
}  # of those that move the entries of a surface
# From which a nuisance is worth a line to a user: known to be there, and large enough
# to matter.
SHOWN_SIGMA = 3.0
SHOWN_SHARE = 0.03  # of the friction's RMS
SHOWN_DELAY_S = 1e-3
SHOWN_PER_KELVIN = 2e-3


@dataclass(frozen=True, kw_only=True)
class NuisancePriors:
    """Standard deviations of the nuisance terms before any log was seen.

    Drives and loggers of the recorded robots lie within two of them. `session_share`:
    by how much offset and asymmetry change between the trials of friction and moves
    recorded later, as drives warm up.
    """

    common_delay_s: float = 3e-3
    own_delay_s: float = 0.6e-3
    offset_share: float = 0.1  # of the friction's RMS
    asymmetry: float = 0.1
    per_kelvin: float = 0.02
    session_share: float = 0.02

    @property
    def delay_s(self) -> float:
        """Standard deviation of the delay of one joint alone [s]."""
        return float(np.hypot(self.common_delay_s, self.own_delay_s))

    def delay_covariance(self, joints: int) -> Array:
        """Covariance (n, n) [s^2] of the delays of so many joints."""
        common = np.full((joints, joints), self.common_delay_s**2)
        return common + self.own_delay_s**2 * np.eye(joints)

    def even_std(self, friction_rms: float) -> Array:
        """Return standard deviations (3,) of offset [N m] and asymmetries."""
        return np.array(
            [self.offset_share * friction_rms, self.asymmetry, self.asymmetry]
        )

    def session_std(self, friction_rms: float) -> Array:
        """Return standard deviations (3,) of their change from session to session."""
        return self.session_share * np.array([friction_rms, 1.0, 1.0])


PRIORS = NuisancePriors()


@dataclass(frozen=True, kw_only=True)
class EvenPart:
    """Offset and asymmetries of one joint's friction, with their covariance (3, 3)."""

    values: Array
    covariance: Array

    @classmethod
    def of_joint(cls, joint: FrictionJoint, friction_rms: float) -> "EvenPart":
        """Return what a file says; zero within the prior where it says nothing."""
        stated = {term.name: term.value for term in joint.nuisances}
        if not joint.nuisance_covariance:
            prior_std = PRIORS.even_std(friction_rms)
            return cls(values=np.zeros(EVEN_TERMS), covariance=np.diag(prior_std**2))
        values = np.array([stated.get(name, 0.0) for name in EVEN_NAMES])
        return cls(values=values, covariance=np.array(joint.nuisance_covariance))

    def terms(self, joint: str, unit: str) -> list[Nuisance]:
        """Return the terms as a file has them."""
        std_errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return [
            Nuisance(
                name=name,
                joint=joint,
                value=float(value),
                std_error=float(std_error),
                unit=unit if name == "offset" else "",
            )
            for name, value, std_error in zip(
                EVEN_NAMES, self.values, std_errors, strict=True
            )
        ]


def dry_entries(entries: Array) -> Array:
    """Return entries (size, l + 1) N m of a surface's value at its slowest speed."""
    # Chebyshev polynomials of the scaled speed are +1 and -1 there in turn.
    at_slowest = (-1.0) ** np.arange(entries.shape[1])
    dry = np.zeros_like(entries)
    dry[:, 0] = entries @ at_slowest
    return dry


def even_jacobian(odd_entries: Array) -> Array:
    """Return changes of both directions' entries by offset and asymmetries.

    Parameters
    ----------
    odd_entries : (size, l + 1) array
        Entries [N m] of the mean of both directions' surfaces.

    Returns
    -------
    (2 size (l + 1), 3) array
        Change of [forward, backward] entries per offset [N m] and per asymmetry.
    """
    # What is the same torque either way is, with the sign of motion taken off, added to
    # the surface of one direction and subtracted from the other's. The first entry is
    # that of 1.
    constant = np.zeros(odd_entries.size)
    constant[0] = 1.0
    dry = dry_entries(odd_entries)
    forward = np.column_stack([constant, dry.ravel(), (odd_entries - dry).ravel()])
    return np.concatenate([forward, -forward])


def with_even_part(joint: FrictionJoint, name: str, even: EvenPart) -> FrictionJoint:
    """Return a joint's friction with another estimate of its offset and asymmetry."""
    forward = np.array(joint.positive)
    backward = np.array(joint.negative)
    size = forward.size
    jacobian = even_jacobian((forward + backward) / 2.0)

    covariance = np.array(joint.covariance)
    change = even.values
    if joint.nuisance_covariance:
        stated = EvenPart.of_joint(joint, 0.0)
        covariance = covariance - jacobian @ stated.covariance @ jacobian.T
        change = even.values - stated.values
    elif not joint.directional:
        covariance = np.tile(covariance, (2, 2))
    covariance = covariance + jacobian @ even.covariance @ jacobian.T

    moved = jacobian @ change
    return replace(
        joint,
        directional=True,
        positive=(forward + moved[:size].reshape(forward.shape)).tolist(),
        negative=(backward + moved[size:].reshape(forward.shape)).tolist(),
        covariance=_possible(covariance).tolist(),
        term_moves=_of_both_directions(joint),
        nuisances=[
            *(term for term in joint.nuisances if term.name in TERM_UNITS),
            *even.terms(name, joint.unit),
        ],
        nuisance_covariance=even.covariance.tolist(),
    )


def _of_both_directions(joint: FrictionJoint) -> dict[str, list[float]]:
    if joint.directional:
        return joint.term_moves
    return {name: 2 * moves for name, moves in joint.term_moves.items()}


def term_of(joint: FrictionJoint, name: str) -> Nuisance | None:
    """Return a term that a joint's friction was identified with, else None."""
    return next((term for term in joint.nuisances if term.name == name), None)


@dataclass(frozen=True)
class FrictionChange:
    """A term that a joint's friction was identified with, and friction's change.

    The change is per unit of the term.
    """

    value: float
    std_error: float
    per_unit: FrictionSurface


def change_of(joint: FrictionJoint, name: str) -> FrictionChange | None:
    """Return a term of a joint's friction, and friction's change; None without one."""
    stated = term_of(joint, name)
    if stated is None or name not in joint.term_moves:
        return None
    moves = np.array(joint.term_moves[name])
    shape = np.shape(joint.positive)
    size = np.size(joint.positive)
    ahead = moves[:size].reshape(shape)
    back = moves[size:].reshape(shape) if joint.directional else ahead
    moved = replace(joint, positive=ahead.tolist(), negative=back.tolist())
    return FrictionChange(
        value=stated.value,
        std_error=stated.std_error,
        per_unit=FrictionSurface.from_stage(moved),
    )


def thermal_column(
    surface: FrictionSurface, change: FrictionChange, kelvin: Array, q: Array, v: Array
) -> Array:
    """Return the torque (N,) [N m K] per unit of a joint's thermal change.

    Parameters
    ----------
    surface : FrictionSurface
    change : FrictionChange
        Its thermal term: where trials were warmer and colder, entries go with it.
    kelvin : (N,) array
        The joint's temperature above that of the surface [K].
    q, v : (N,) arrays
        Positions [rad] and velocities [rad/s].
    """
    return kelvin * surface.torque(q, v) + change.per_unit.torque(q, v)


def with_term(
    joint: FrictionJoint, name: str, value: float, std_error: float
) -> FrictionJoint:
    """Return a joint's friction for the delay or thermal change of other logs.

    Parameters
    ----------
    joint : FrictionJoint
        Friction whose entries move by `term_moves` per unit of the term.
    name : str
        "delay" or "thermal".
    value, std_error : float
        The term and its standard error [s, or 1/K].
    """
    stated = term_of(joint, name)
    if stated is None or name not in joint.term_moves:
        return joint

    moves = np.array(joint.term_moves[name])
    shape = np.shape(joint.positive)
    size = shape[0] * shape[1]
    change = moves * (value - stated.value)
    forward = np.array(joint.positive) + change[:size].reshape(shape)
    backward = forward
    if joint.directional:
        backward = np.array(joint.negative) + change[size:].reshape(shape)

    variance = std_error**2 - stated.std_error**2
    covariance = np.array(joint.covariance) + variance * np.outer(moves, moves)
    if joint.nuisance_covariance:
        # Asymmetries are shares of the mean of both directions, which has moved as
        # well.
        even = np.array(joint.nuisance_covariance)
        mean = (np.array(joint.positive) + np.array(joint.negative)) / 2.0
        old_jacobian = even_jacobian(mean)
        new_jacobian = even_jacobian((forward + backward) / 2.0)
        covariance += (
            new_jacobian @ even @ new_jacobian.T - old_jacobian @ even @ old_jacobian.T
        )
    term = replace(stated, value=value, std_error=std_error)
    return replace(
        joint,
        positive=forward.tolist(),
        negative=backward.tolist(),
        covariance=_possible(covariance).tolist(),
        nuisances=[term if x.name == name else x for x in joint.nuisances],
    )


def _possible(covariance: Array) -> Array:
    """Return the nearest matrix that is a covariance.

    What a term makes of the entries is taken off as if it were apart from what others
    make. Where trials hardly told them from each other, more is taken off than there
    is.
    """
    variance, directions = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray((directions * np.maximum(variance, 0.0)) @ directions.T)


def with_drive_terms(
    joint: FrictionJoint,
    name: str,
    surface: FrictionSurface,
    *,
    theta: Array,
    covariance: Array,
    places: Mapping[str, int],
) -> FrictionJoint:
    """Return a joint's friction with its drive's terms as a later stage finds them.

    Parameters
    ----------
    joint : FrictionJoint
    name : str
        The joint's name.
    surface : FrictionSurface
        The joint's friction.
    theta : (p,) array
        The stage's unknowns. A delay [s] is found as it is, any other term as its
        change against the file.
    covariance : (p, p) array
        Of the unknowns.
    places : mapping of str to int
        Where terms stand among the unknowns that the stage tells, by their names:
        "delay", "thermal", and all of `EVEN_NAMES` or none.
    """
    for term_name in ("delay", "thermal"):
        stated = term_of(joint, term_name)
        if term_name not in places or stated is None:
            continue
        place = places[term_name]
        value = float(theta[place])
        if term_name == "thermal":
            value += stated.value
        std_error = float(np.sqrt(covariance[place, place]))
        joint = with_term(joint, term_name, value, std_error)

    even_places = [places[term] for term in EVEN_NAMES if term in places]
    if not even_places:
        return joint
    of_file = EvenPart.of_joint(joint, friction_rms(surface))
    even = EvenPart(
        values=of_file.values + theta[even_places],
        covariance=covariance[np.ix_(even_places, even_places)],
    )
    return with_even_part(joint, name, even)


def friction_rms(surface: FrictionSurface, *, cells: int = 9) -> float:
    """Return RMS friction [N m] over identified positions and speeds, both ways."""
    low, high = surface.scaling.position
    slow, fast = surface.scaling.speed
    places, speeds = np.meshgrid(
        np.linspace(low, high, cells), np.linspace(slow, fast, cells)
    )
    odd = surface.odd_torque(places.ravel(), speeds.ravel())
    return float(np.sqrt(np.mean(odd**2)))


def even_surfaces(surface: FrictionSurface) -> list[FrictionSurface]:
    """Return surfaces with the sizes of dry friction and of the rest.

    Each is the same both ways.
    """
    odd = (surface.positive + surface.negative) / 2.0
    dry = dry_entries(odd)
    return [surface.of_size(dry), surface.of_size(odd - dry)]


def even_columns(surface: FrictionSurface, q: Array, v: Array) -> Array:
    """Return the torques (N, 3) of one offset and one of each asymmetry [N m]."""
    sizes = [part.torque(q, v) for part in even_surfaces(surface)]
    return np.column_stack([np.ones(len(q)), *sizes])


def shown(terms: Sequence[Nuisance], friction: Mapping[str, float]) -> list[Nuisance]:
    """Return the terms that logs show and that matter beside RMS `friction`."""
    shown_terms = []
    for term in terms:
        least = SHOWN_SHARE
        if term.name not in DRIVE_NAMES:
            continue
        if term.name == "offset":
            least = SHOWN_SHARE * friction.get(term.joint, 0.0)
        if term.name == "delay":
            least = SHOWN_DELAY_S
        if term.name == "thermal":
            least = SHOWN_PER_KELVIN
        if abs(term.value) > max(SHOWN_SIGMA * term.std_error, least):
            shown_terms.append(term)
    return shown_terms


def described(term: Nuisance) -> str:
    """Say a term in words, as a note on a stage has it."""
    if term.name == "delay":
        direction = "late" if term.value > 0.0 else "early"
        size = f"{1e3 * abs(term.value):.2g} +- {1e3 * term.std_error:.1g} ms"
        return f"{term.joint}: torque is {size} {direction} against the positions"
    if term.name == "thermal":
        size = f"{100.0 * term.value:.2g} +- {100.0 * term.std_error:.1g} %"
        return f"{term.joint}: friction changes by {size} per kelvin"
    if term.name == "offset":
        size = f"{term.value:.3g} +- {term.std_error:.1g} {term.unit}"
        return f"{term.joint}: torque has an offset of {size}"
    direction = "forward" if term.value > 0.0 else "backward"
    share = f"{100.0 * abs(term.value):.2g} +- {100.0 * term.std_error:.1g} %"
    kind = "viscous friction" if term.name == "viscous_asymmetry" else "friction"
    return f"{term.joint}: {kind} is {share} of its mean larger {direction}"


def robot_friction_rms(
    surfaces: Sequence[FrictionSurface | None], robot: Robot
) -> dict[str, float]:
    """Return the RMS friction [N m] of each joint whose friction is known."""
    return {
        name: friction_rms(surface)
        for name, surface in zip(robot.joint_names, surfaces, strict=True)
        if surface is not None
    }
