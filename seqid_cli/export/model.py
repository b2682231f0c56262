"""The exported model, whatever the format: bodies, rotors, friction, and effects left out."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

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

_POSITIONS, _SPEEDS = 41, 60
# What becomes of an effect.
LEFT_OUT = "cannot be written to a model file and is left out"
ADDED = "added to the inertial parameters"
WRITTEN = "written as it is"


@dataclass(frozen=True, kw_only=True)
class Loss:
    """What a form loses of the file's torque, while joints slide.

    `rms` (n,) N m (N where prismatic) is for motion that no number was fitted to: that
    of the `replayed_logs`, and of left-out pieces of the `logs`, or of `made` motions,
    for a joint that slides in none of these. `replayed_rms` is on the first alone,
    `by_log` (k, n) on each log of both kinds. NaN for a joint that never slides there.
    """

    rms: Array
    replayed_rms: Array
    by_log: Array
    logs: int
    replayed_logs: int
    made: bool

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
        return "made motions" if self.made else f"{self.logs} of the file's logs"

    def stated(self, names: Sequence[str]) -> dict[str, float | None]:
        """Return the loss of each joint, None where it is not known."""
        return _by_joint(names, self.rms)

    def ranges(self, names: Sequence[str]) -> dict[str, list[float]]:
        """Return the smallest and the largest loss of each joint in a single log."""
        found: dict[str, list[float]] = {}
        for name, of_joint in zip(names, self.by_log.T, strict=True):
            known = of_joint[np.isfinite(of_joint)]
            if known.size:
                found[name] = [float(known.min()), float(known.max())]
        return found

    def on_replayed(self, names: Sequence[str]) -> dict[str, float | None]:
        """Return the loss of each joint on the logs to replay, None where it is not known."""
        return _by_joint(names, self.replayed_rms)


def _by_joint(names: Sequence[str], values: Array) -> dict[str, float | None]:
    pairs = zip(names, values.tolist(), strict=True)
    return {name: None if math.isnan(value) else value for name, value in pairs}


@dataclass(frozen=True)
class ExportModel:
    """One arm, ready to be written."""

    robot: Robot
    urdf: UrdfText | None  # that of the robot
    # of the URDF that belong to each joint; empty without one
    links: tuple[UrdfBody, ...]
    # links' inertials as written, and rotor inertias, motor side, kg m^2
    nearest: NearestBodies
    # (n, 10) the rest of each body: links behind other joints, which keep theirs
    kept: Array
    coupling: Coupling
    surfaces: tuple[FrictionSurface | None, ...]
    friction: tuple[ExportedFriction | None, ...]
    deviations: tuple[ExportedParameter, ...]  # of every identified base parameter
    added: Array  # (11 n,) what effects add to the standard parameters, rotors last
    # (n, 4) torque of a joint by powers of its position, N m, N m/rad ...
    springs: Array
    gaps: Array  # (n,) rad, backlash
    effects: tuple[Fitted, ...]  # that code says
    base: TorqueModel  # without effects, as they see it
    observer: Thresholds  # when a momentum observer raises an alarm
    notes: tuple[str, ...]  # what the reader of the file has to know
    loss: Loss | None = None  # against the file; None where it has not been looked at
    # whether the numbers are those that lose least, not the file's own
    refitted: bool = False
    # Of code, whose links have exactly the file's torque: the nearest bodies that can
    # exist.
    physical: NearestBodies | None = None
    writes_offset: bool = False  # whether the form has a place for a constant torque

    @property
    def bodies(self) -> Array:
        """Standard parameters (n, 10) of the bodies that each joint moves."""
        return self.nearest.links + self.kept

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

    `stages`: whatever was identified. Without an inertia stage the URDF must say what
    is missing. `holds`: effects that the format has a place for, None where it has one
    for every effect. `errors`: RMS error of the torque of each joint [N m] on new logs;
    those of the inertia stage if left out.
    """
    if stages.inertia is None and robot.nominal is None:
        message = (
            "the file holds no inertia stage, and the robot file names no URDF with"
            " inertials"
        )
        hint = "Run seqid inertia first and export its result."
        raise ConfigError(
            f"{message} that could stand in", where=str(robot.source), hint=hint
        )
    rigid = stages.inertia or stages.gravity
    coupled = rigid is not None and rigid.rotor_coupling == "gyroscopic"
    coupling: Coupling = "gyroscopic" if coupled else "diagonal"
    effects = _effects(stages, robot, holds, coupling)
    demand = identified(stages, robot, more=effects.parameters)
    urdf = None if robot.urdf is None else read_urdf_text(robot.urdf)
    links = () if urdf is None else bodies_of_urdf(urdf, robot.joint_names)
    kept = (
        np.array([body.kept for body in links])
        if links
        else np.zeros((robot.n, PER_LINK))
    )
    nearest = nearest_bodies(robot, demand, kept)
    surfaces = tuple(friction_surfaces(stages, robot))
    friction = tuple(None if s is None else simple_friction(s) for s in surfaces)
    found = _notes_on_links(robot, stages, demand, nearest)
    mass = largest_mass(
        robot, nearest.links + kept, gear_ratios(robot) ** 2 * nearest.rotor
    )
    return ExportModel(
        robot=robot,
        urdf=urdf,
        links=links,
        nearest=nearest,
        kept=kept,
        coupling=coupling,
        surfaces=surfaces,
        friction=friction,
        deviations=demand.deviations(nearest.links + kept, nearest.rotor),
        added=effects.parameters,
        springs=effects.springs,
        gaps=effects.gaps,
        effects=effects.coded,
        base=TorqueModel.from_stages(stages, robot),
        observer=thresholds(robot, stages, surfaces, mass, errors),
        notes=(*found, *_notes_on_friction(robot, friction), *effects.notes),
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
    demand = identified(stages, model.robot, more=model.added)
    n = model.robot.n
    standard = np.concatenate([model.bodies.ravel(), model.nearest.rotor])
    gap = demand.whole_values - demand.basis.expression @ standard
    rows = np.arange(demand.basis.size) if stages.inertia else np.array(demand.rows)
    standard = standard + demand.basis.representative[:, rows] @ gap[rows]
    links = standard[: PER_LINK * n].reshape(n, PER_LINK) - model.kept
    nearest = replace(
        model.nearest, links=links, rotor=standard[PER_LINK * n :], exact=True
    )
    phi, rotor = links + model.kept, nearest.rotor
    return replace(
        model,
        nearest=nearest,
        physical=model.nearest,
        deviations=demand.deviations(phi, rotor),
    )


@dataclass(frozen=True, kw_only=True)
class _Effects:
    """Effects of a file in one format.

    `parameters` (11 n,) are standard parameters to be added, rotors last; `springs` and
    `gaps` as in `ExportModel`; `coded` are effects that code has to say.
    """

    parameters: Array
    springs: Array
    gaps: Array
    coded: tuple[Fitted, ...]
    notes: tuple[str, ...]


def _effects(
    stages: Stages, robot: Robot, holds: Collection[str] | None, coupling: Coupling
) -> _Effects:
    """Say what becomes of each effect in a format that `holds` some, or, None, every one.

    A payload counts as it was in the last log.
    """
    n = robot.n
    parameters, springs, gaps = (
        np.zeros((PER_LINK + 1) * n),
        np.zeros((n, 4)),
        np.zeros(n),
    )
    last = slice(PER_LINK * (n - 1), PER_LINK * n)
    coded: list[Fitted] = []
    notes = []
    for item in fitted_effects(stages, robot, unexplained=True):
        name, fate, j = "a smooth term of no known cause", LEFT_OUT, item.joint or 0
        if isinstance(item, FittedEffect):
            name, c = item.effect.name, item.coefficients
            diagonal = coupling == "diagonal" and not item.settings.get("coupling")
            if name == "payload" or (name == "rotor_inertia" and diagonal):
                parameters[last if name == "payload" else PER_LINK * n + j] += (
                    c.squeeze()
                )
                fate = ADDED
            elif holds is not None and name in holds:
                fate = WRITTEN
                if name == "backlash":
                    gaps[j] += c[0]
                else:
                    springs[j, : len(c)] += c[[1, 0, 3, 2][: len(c)]]
        if holds is None and fate == LEFT_OUT:
            coded.append(item)
            fate = WRITTEN
        notes.append(f"{fate}: {name} ({robot.name_of(item.joint) or 'all joints'})")
    return _Effects(
        parameters=parameters,
        springs=springs,
        gaps=gaps,
        coded=tuple(coded),
        notes=tuple(notes),
    )


def _notes_on_links(
    robot: Robot, stages: Stages, demand: Identified, nearest: NearestBodies
) -> Iterator[str]:
    if stages.inertia is None:
        what = "masses and inertias" if stages.gravity is None else "inertias"
        yield (
            f"no inertia stage in the file: {what} are the URDF's, as far as gravity"
            " lets"
        )
    elif demand.open:
        yield "not determined by the logs, so as in the prior: " + "; ".join(
            demand.open
        )
    joints = zip(robot.joint_names, nearest.from_cad, strict=True)
    if guessed := [name for name, cad in joints if not cad]:
        unseen = "no inertial in a URDF, so that what torque does not show"
        why = (
            f"{unseen} was guessed from the arm's geometry (the torque does not depend"
            " on it)"
        )
        yield f"{why}: links of {', '.join(guessed)}"


def _notes_on_friction(
    robot: Robot, friction: tuple[ExportedFriction | None, ...], *, poor: float = 0.2
) -> Iterator[str]:
    for name, fit in zip(robot.joint_names, friction, strict=True):
        if fit is None:
            yield f"{name}: friction was not identified and is left out"
            continue
        if fit.rms_misfit > poor * fit.rms:
            share = (
                f"{100.0 * fit.rms_misfit / fit.rms:.0f} % of the identified friction"
                " surface"
            )
            sizes = f"({fit.rms_misfit:.3g} of {fit.rms:.3g} RMS)"
            yield f"{name}: Coulomb and viscous friction miss {share} {sizes}"
        if abs(fit.offset) > poor * fit.rms:
            constant = (
                f"a constant of {fit.offset:.3g} that does not change with the"
                " direction"
            )
            yield f"{name}: {constant} has no place in model files"


def simple_friction(surface: FrictionSurface) -> ExportedFriction:
    """Fit coulomb sign(v) + viscous v to a surface, uniformly over its positions and speeds.

    Neither is negative; the offset is the mean part that does not flip with the
    direction.
    """
    low, high = surface.scaling.speed
    low = min(max(low, SLIDES * surface.sign_width), high)
    speeds = np.linspace(low, high, _SPEEDS)
    positions = np.linspace(*surface.scaling.position, _POSITIONS)
    q, v = (
        x.ravel() for x in np.meshgrid(positions, np.concatenate([-speeds, speeds]))
    )
    tau = surface.torque(q, v)
    columns = np.column_stack([np.sign(v), v])
    fitted, _ = nnls(columns, tau)
    misfit = tau - columns @ fitted
    return ExportedFriction(
        coulomb=float(fitted[0]),
        viscous=float(fitted[1]),
        offset=float(tau.mean()),
        rms_misfit=float(np.sqrt(np.mean(misfit**2))),
        rms=float(np.sqrt(np.mean(tau**2))),
        speed_range=[float(low), float(high)],
    )
