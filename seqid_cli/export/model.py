"""The exported model, whatever the format.

It has bodies, rotors and friction, and says which effects are left out.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import nnls

from seqid_cli.effects.fitted import Fitted, FittedEffect, fitted_effects
from seqid_cli.errors import ConfigError
from seqid_cli.export.observer import Thresholds, largest_mass, thresholds
from seqid_cli.export.urdf_tree import UrdfBody, bodies_of_urdf
from seqid_cli.model.bodies.nearest import (
    Identified,
    NearestBodies,
    identified,
    nearest_bodies,
)
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.model.torque import TorqueModel, friction_surfaces
from seqid_cli.params.results.export import ExportedFriction, ExportedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.regressor import PER_LINK, Coupling
from seqid_cli.robot.types import Array, Robot
from seqid_cli.robot.urdf import UrdfText, read_urdf_text

# Of the grid over which simple friction is fitted to a surface.
_POSITIONS = 41
_SPEEDS = 60
# What becomes of an effect.
LEFT_OUT = "cannot be written to a model file and is left out"
ADDED = "added to the inertial parameters"
WRITTEN = "written as it is"


@dataclass(frozen=True, kw_only=True)
class Loss:
    """What a form loses of the file's torque, while joints slide.

    Attributes
    ----------
    rms : (n,) array
        N m (N where prismatic), for motion that no number was fitted to: that of the
        replayed logs, and of left-out pieces of the fitted motion for a joint that
        slides in none of these. NaN for a joint that never slides.
    replayed_rms : (n,) array
        The same on the replayed logs alone.
    by_log : (k, n) array
        The same on each fitted and each replayed log.
    logs, replayed_logs : int
        Numbers of fitted and of replayed logs.
    is_made : bool
        Whether the fitted motion was made, since no log is left.
    """

    rms: Array
    replayed_rms: Array
    by_log: Array
    logs: int
    replayed_logs: int
    is_made: bool

    @property
    def motion(self) -> str:
        """Say of which motion what is lost is stated."""
        if not self.replayed_logs:
            return f"left-out pieces of {self.fitted_motion}"
        if self.replayed_logs == 1:
            return "the replayed log"
        return f"the {self.replayed_logs} replayed logs"

    @property
    def fitted_motion(self) -> str:
        """Say what the numbers are fitted to."""
        return "made motions" if self.is_made else f"{self.logs} of the file's logs"

    def stated(self, names: Sequence[str]) -> dict[str, float | None]:
        """Return the loss of each joint, None where it is not known."""
        return _by_joint(names, self.rms)

    def ranges(self, names: Sequence[str]) -> dict[str, list[float]]:
        """Return the smallest and the largest loss of each joint in a single log."""
        ranges: dict[str, list[float]] = {}
        for name, of_joint in zip(names, self.by_log.T, strict=True):
            finite = of_joint[np.isfinite(of_joint)]
            if finite.size:
                ranges[name] = [float(finite.min()), float(finite.max())]
        return ranges

    def on_replayed(self, names: Sequence[str]) -> dict[str, float | None]:
        """Return the loss of each joint on the logs to replay, None if not known."""
        return _by_joint(names, self.replayed_rms)


def _by_joint(names: Sequence[str], values: Array) -> dict[str, float | None]:
    """Return values (n,) by the names of joints, None for NaN."""
    pairs = zip(names, values.tolist(), strict=True)
    return {name: None if math.isnan(value) else value for name, value in pairs}


@dataclass(frozen=True, kw_only=True)
class ExportModel:
    """One arm, ready to be written.

    Attributes
    ----------
    robot : Robot
        The arm.
    urdf : UrdfText or None
        That of the robot.
    links : tuple of UrdfBody
        Of the URDF, those that belong to each joint; empty without one.
    nearest : NearestBodies
        Links' inertials as written, and rotor inertias, motor side, kg m^2.
    locked_links : (n, 10) array
        Standard parameters of the rest of each body: links behind joints that are not
        identified, which keep theirs.
    coupling : Coupling
        Whether rotors turn the links that carry them as well.
    surfaces : tuple of FrictionSurface or None
        Friction of each joint as it was identified.
    friction : tuple of ExportedFriction or None
        Coulomb and viscous friction of each joint.
    deviations : tuple of ExportedParameter
        Of every identified base parameter.
    added : (11 n,) array
        What effects add to the standard parameters, rotors last.
    springs : (n, 4) array
        Torque of a joint by powers of its position, N m, N m/rad ...
    gaps : (n,) array
        Backlash, rad.
    effects : tuple of FittedEffect or SmoothTerm
        Those that code says.
    base : TorqueModel
        The model without effects, as they see it.
    observer : Thresholds
        When a momentum observer raises an alarm.
    notes : tuple of str
        What the reader of the file has to know.
    loss : Loss or None
        Against the file; None where it has not been looked at.
    refitted : bool
        Whether the numbers are those that lose least, not the file's own.
    physical : NearestBodies or None
        Of code, whose links have exactly the file's torque: the nearest bodies that can
        exist.
    writes_offset : bool
        Whether the form has a place for a constant torque.
    """

    robot: Robot
    urdf: UrdfText | None
    links: tuple[UrdfBody, ...]
    nearest: NearestBodies
    locked_links: Array
    coupling: Coupling
    surfaces: tuple[FrictionSurface | None, ...]
    friction: tuple[ExportedFriction | None, ...]
    deviations: tuple[ExportedParameter, ...]
    added: Array
    springs: Array
    gaps: Array
    effects: tuple[Fitted, ...]
    base: TorqueModel
    observer: Thresholds
    notes: tuple[str, ...]
    loss: Loss | None = None
    refitted: bool = False
    physical: NearestBodies | None = None
    writes_offset: bool = False

    @property
    def bodies(self) -> Array:
        """Standard parameters (n, 10) of the bodies that each joint moves."""
        return self.nearest.links + self.locked_links

    @property
    def standard(self) -> Array:
        """Standard parameters (11 n,) of all bodies, rotors last."""
        return np.concatenate([self.bodies.ravel(), self.nearest.rotor])

    @property
    def armature(self) -> Array:
        """Rotor inertias (n,) as the joints feel them, kg m^2 [kg where prismatic]."""
        return np.asarray(gear_ratios(self.robot) ** 2 * self.nearest.rotor)

    @property
    def largest_deviation(self) -> float:
        """The largest deviation of a base parameter, in standard errors."""
        sizes = [abs(d.std_errors) for d in self.deviations if d.std_errors is not None]
        return max(sizes, default=0.0)


def export_model(
    robot: Robot,
    stages: Stages,
    holds: Collection[str] | None,
    errors: Mapping[str, float] | None,
) -> ExportModel:
    """Find physically consistent parameters of a whole arm.

    Parameters
    ----------
    robot : Robot
        The arm.
    stages : Stages
        Whatever was identified.
    holds : collection of str or None
        Effects that the form has a place for, None where it has one for every effect.
    errors : mapping of str to float or None
        RMS error of the torque of each joint on new logs, N m (N where prismatic);
        that of the inertia stage if left out.

    Raises
    ------
    ConfigError
        There is neither an inertia stage nor a URDF with inertials.
    """
    if stages.inertia is None and robot.nominal is None:
        raise ConfigError(
            "the file holds no inertia stage, and the robot file names no URDF with"
            " inertials that could stand in",
            where=str(robot.source),
            hint="Run seqid inertia first and export its result.",
        )

    rigid = stages.inertia or stages.gravity
    is_coupled = rigid is not None and rigid.rotor_coupling == "gyroscopic"
    coupling: Coupling = "gyroscopic" if is_coupled else "diagonal"
    effects = _effects(stages, robot, holds, coupling)

    # Links behind joints that were not identified are part of the torque, and keep
    # their own inertials: the bodies are found beside them.
    urdf = None if robot.urdf is None else read_urdf_text(robot.urdf)
    links = () if urdf is None else bodies_of_urdf(urdf, robot.joint_names)
    locked_links = np.zeros((robot.n, PER_LINK))
    if links:
        locked_links = np.array([body.locked_links for body in links])
    demand = identified(stages, robot, added_by_effects=effects.parameters)
    nearest = nearest_bodies(robot, demand, locked_links)
    bodies = nearest.links + locked_links
    armature = gear_ratios(robot) ** 2 * nearest.rotor

    surfaces = tuple(friction_surfaces(stages, robot))
    friction = tuple(
        None if surface is None else simple_friction(surface) for surface in surfaces
    )
    mass = largest_mass(robot, bodies, armature)
    return ExportModel(
        robot=robot,
        urdf=urdf,
        links=links,
        nearest=nearest,
        locked_links=locked_links,
        coupling=coupling,
        surfaces=surfaces,
        friction=friction,
        deviations=demand.deviations(bodies, nearest.rotor),
        added=effects.parameters,
        springs=effects.springs,
        gaps=effects.gaps,
        effects=tuple(effects.coded),
        base=TorqueModel.from_stages(stages, robot),
        observer=thresholds(robot, stages, surfaces, mass, errors),
        notes=(
            *_notes_on_links(robot, stages, demand, nearest),
            *_notes_on_friction(robot, friction),
            *effects.notes,
        ),
    )


def with_file_torque(model: ExportModel, stages: Stages) -> ExportModel:
    """Return the model with link parameters whose torque is exactly the file's.

    Code computes torques from any numbers. Those of the nearest bodies that can exist
    may be a standard error away in a direction that matters: they are for simulators.
    With P, E of the base parameters and phi of the nearest bodies, phi + P (pi - E phi)
    has the torque of pi, and the bodies' own numbers for all that torque does not show.
    An arm whose inertia was not identified keeps the bodies' one.
    """
    if stages.inertia is None and stages.gravity is None:
        return model

    demand = identified(stages, model.robot, added_by_effects=model.added)
    basis = demand.basis
    rows = np.array(demand.rows)
    if stages.inertia is not None:
        rows = np.arange(basis.size)
    missing = demand.whole_values - basis.expression @ model.standard
    standard = model.standard + basis.representative[:, rows] @ missing[rows]

    split = PER_LINK * model.robot.n
    rotor = standard[split:]
    links = standard[:split].reshape(-1, PER_LINK) - model.locked_links
    nearest = replace(model.nearest, links=links, rotor=rotor, exact=True)
    return replace(
        model,
        nearest=nearest,
        physical=model.nearest,
        deviations=demand.deviations(links + model.locked_links, rotor),
    )


@dataclass(frozen=True, kw_only=True)
class _Effects:
    """Effects of a file in one form.

    Attributes
    ----------
    parameters : (11 n,) array
        Standard parameters to be added, rotors last.
    springs, gaps : array
        As in `ExportModel`.
    coded : list of FittedEffect or SmoothTerm
        Effects that code has to say.
    notes : list of str
        What becomes of each.
    """

    parameters: Array
    springs: Array
    gaps: Array
    coded: list[Fitted] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def _effects(
    stages: Stages, robot: Robot, holds: Collection[str] | None, coupling: Coupling
) -> _Effects:
    """Say what becomes of each effect in a form that `holds` some, or, None, every one.

    A payload counts as it was in the last log.
    """
    fitted = fitted_effects(stages, robot, unexplained=True)
    in_bodies = [item for item in fitted if is_of_bodies(item, coupling)]
    effects = _Effects(
        parameters=added_parameters(in_bodies, robot.n),
        springs=np.zeros((robot.n, 4)),
        gaps=np.zeros(robot.n),
    )

    for item in fitted:
        fate = LEFT_OUT
        if is_of_bodies(item, coupling):
            fate = ADDED
        elif holds is None:
            effects.coded.append(item)
            fate = WRITTEN
        elif isinstance(item, FittedEffect) and item.effect.name in holds:
            _add_to_joint(effects, item)
            fate = WRITTEN

        name = effect_name(item) or "a smooth term of no known cause"
        place = robot.name_of(item.joint) or "all joints"
        effects.notes.append(f"{fate}: {name} ({place})")
    return effects


def _add_to_joint(effects: _Effects, item: FittedEffect) -> None:
    """Add a backlash or a spring to its joint."""
    joint = item.joint or 0
    coefficients = item.coefficients
    if item.effect.name == "backlash":
        effects.gaps[joint] += coefficients[0]
        return
    # A spring's coefficients are of q, 1, q^3 and q^2.
    by_power = coefficients[[1, 0, 3, 2][: len(coefficients)]]
    effects.springs[joint, : len(by_power)] += by_power


def effect_name(item: Fitted) -> str:
    """Return the name of an effect of the catalogue, nothing for a smooth term."""
    return item.effect.name if isinstance(item, FittedEffect) else ""


def is_of_bodies(item: Fitted, coupling: Coupling) -> bool:
    """Return whether an effect is part of the links' and rotors' own parameters.

    A rotor is, where it feels nothing but its own joint's acceleration.
    """
    name = effect_name(item)
    if name == "payload":
        return True
    if name != "rotor_inertia" or coupling != "diagonal":
        return False
    return isinstance(item, FittedEffect) and not item.settings.get("coupling")


def added_parameters(effects: Sequence[Fitted], n_joints: int) -> Array:
    """Return what effects that are of bodies add to the standard parameters.

    Parameters
    ----------
    effects : sequence of FittedEffect
        Payloads and rotor inertias.
    n_joints : int
        Number of joints.

    Returns
    -------
    (11 n,) array
        Ten for each body, a payload among those of the last; rotors behind them.
    """
    added = np.zeros((PER_LINK + 1) * n_joints)
    rotors = PER_LINK * n_joints
    for item in effects:
        assert isinstance(item, FittedEffect)
        if effect_name(item) == "payload":
            added[rotors - PER_LINK : rotors] += item.coefficients
        else:
            added[rotors + (item.joint or 0)] += float(item.coefficients[0])
    return added


def _notes_on_links(
    robot: Robot, stages: Stages, demand: Identified, nearest: NearestBodies
) -> Iterator[str]:
    """Say which numbers of links are not those of the logs."""
    if stages.inertia is None:
        numbers = "inertias"
        if stages.gravity is None:
            numbers = "masses and inertias"
        yield (
            f"no inertia stage in the file: {numbers} are the URDF's, as far as gravity"
            " lets"
        )
    elif demand.open:
        names = "; ".join(demand.open)
        yield f"not determined by the logs, so as in the prior: {names}"

    joints = zip(robot.joint_names, nearest.from_cad, strict=True)
    guessed = [name for name, is_from_cad in joints if not is_from_cad]
    if guessed:
        yield (
            "no inertial in a URDF, so that what torque does not show was guessed from"
            " the arm's geometry (the torque does not depend on it): links of"
            f" {', '.join(guessed)}"
        )


def _notes_on_friction(
    robot: Robot, friction: Sequence[ExportedFriction | None], *, poor: float = 0.2
) -> Iterator[str]:
    """Say where Coulomb and viscous friction are not all of a joint's friction.

    `poor` is the share of friction from which on a misfit is worth a note.
    """
    for name, fit in zip(robot.joint_names, friction, strict=True):
        if fit is None:
            yield f"{name}: friction was not identified and is left out"
            continue
        if fit.rms_misfit > poor * fit.rms:
            percent = 100.0 * fit.rms_misfit / fit.rms
            yield (
                f"{name}: Coulomb and viscous friction miss {percent:.0f} % of the"
                f" identified friction surface ({fit.rms_misfit:.3g} of {fit.rms:.3g}"
                " RMS)"
            )
        if abs(fit.offset) > poor * fit.rms:
            yield (
                f"{name}: a constant of {fit.offset:.3g} that does not change with the"
                " direction has no place in model files"
            )


def simple_friction(surface: FrictionSurface) -> ExportedFriction:
    """Fit Coulomb and viscous friction to a surface, uniformly all over it.

    Neither c nor d of c sign(v) + d v is negative; the offset is the mean part that
    does not flip with the direction.
    """
    grid = surface_grid(surface, positions=_POSITIONS, speeds=_SPEEDS)
    q = grid.q
    v = grid.v
    tau = surface.torque(q, v)
    columns = np.column_stack([np.sign(v), v])
    coefficients, _ = nnls(columns, tau)
    misfit = tau - columns @ coefficients
    return ExportedFriction(
        coulomb=float(coefficients[0]),
        viscous=float(coefficients[1]),
        offset=float(tau.mean()),
        rms_misfit=float(np.sqrt(np.mean(misfit**2))),
        rms=float(np.sqrt(np.mean(tau**2))),
        speed_range=[float(np.abs(v).min()), float(np.abs(v).max())],
    )


@dataclass(frozen=True, kw_only=True)
class SurfaceGrid:
    """Positions `q` (M,) [rad] and velocities `v` (M,) [rad/s] all over a surface."""

    q: Array
    v: Array


def surface_grid(
    surface: FrictionSurface, *, positions: int, speeds: int
) -> SurfaceGrid:
    """Return so many positions, each at so many speeds in both directions.

    Speeds at which friction changes its sign are left out.
    """
    slowest, fastest = surface.scaling.speed
    slowest = min(max(slowest, SLIDES * surface.sign_width), fastest)
    speed = np.linspace(slowest, fastest, speeds)
    position = np.linspace(*surface.scaling.position, positions)
    q, v = np.meshgrid(position, np.concatenate([-speed, speed]))
    return SurfaceGrid(q=q.ravel(), v=v.ravel())
