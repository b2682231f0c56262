"""Effects of the model's file in a simulated arm.

`refine` has identified each effect along recorded motions. A simulation asks for its
torque at states of its own:

- *Friction*: what it adds to the friction of a joint that moves either way, and that
  may hold it at rest. Where it depends on the joint's own position and speed alone it
  stands in the friction table, else it is evaluated at every step.
- *Bristles* of presliding friction: their deflection is a state of the simulation.
- *Other torques* of position, speed and load (a spring, a ripple) act on the arm.
- *Bodies* (a payload, a rotor, a tilted base) change the arm itself.
- *Measured torque* (torque constant, bias, saturation): the log's torque is put right
  before anything is compared with it; the arm does not feel how it is measured.

What has no such form is named and left out: nothing is dropped silently.

Symbols: B windows, n joints; c (k,) coefficients of an effect.
"""

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.friction_table import AddedFriction
from seqid_cli.effects.apply import place_of
from seqid_cli.effects.declared import BodyTerm
from seqid_cli.effects.effect import acts_in_log
from seqid_cli.effects.fitted import FittedEffect, fitted_effects
from seqid_cli.effects.law import (
    Evaluated,
    Law,
    catalogue_symbol,
    compiled,
    direction_of,
    tree_of,
)
from seqid_cli.effects.measurement import TorqueMeasurement
from seqid_cli.effects.memory import Bristles, deflection
from seqid_cli.effects.units import UNEXPLAINED
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Quantities of which a friction table knows the joint's own, and those that a simulated
# step knows of every joint.
OF_TABLE = frozenset({"q", "dq", "theta", "sign_width", "rotor", "coulomb_share"})
KNOWN = OF_TABLE | {"load", "load_is_modelled", "temperature"}
USUAL_SIGN_WIDTH = 0.01  # rad/s, where no friction was identified
PLACES = 65  # over which the mean of Coulomb friction is taken
# The effect of a file that is the same friction as the term `load_friction` of a drive.
FRICTION_OF_LOAD = "load_dependent_friction"


@dataclass(frozen=True, kw_only=True)
class State:
    """What a step of the simulation knows, (B, n) each.

    Attributes
    ----------
    q, dq : array
        rad, rad/s.
    load : array
        N m, of Coriolis and gravity: the acceleration of a step is not known before it.
    sign : array
        Direction of motion, -1 to 1.
    celsius : array, optional
        degC.
    """

    q: Array
    dq: Array
    load: Array
    sign: Array
    celsius: Array | None = None


@dataclass(frozen=True, kw_only=True)
class EffectTorque:
    """The law of an effect at one joint, with its coefficients."""

    name: str
    joint: int
    law: Law
    coefficients: Array
    bristles: Bristles | None = None

    @property
    def rubs(self) -> bool:
        """True where the torque turns with the direction of motion, as friction's."""
        texts = (*self.law.terms, *self.law.parts.values())
        return any(
            direction_of(node) is not None
            for text in texts
            for node in ast.walk(tree_of(text))
            if isinstance(node, ast.expr)
        )

    @property
    def stands_in_table(self) -> bool:
        """True where it is friction by the joint's own position and speed."""
        own = (None, self.joint)
        return (
            self.rubs
            and self.bristles is None
            and all(
                symbol.name in OF_TABLE and symbol.joint in own
                for symbol in self.law.symbols
            )
        )

    def torque(
        self, state: State, model: TorqueModel, bristle: Evaluated = 0.0
    ) -> Array:
        """Return the torque (B,) N m at a state."""
        values: dict[str, Evaluated] = {**self.law.numbers, "bristle": bristle}

        def lookup(name: str) -> Evaluated:
            if name not in values:
                values[name] = self._quantity(name, state, model)
            return values[name]

        for name, text in self.law.parts.items():
            values[name] = compiled(text)(lookup)
        total = np.zeros(len(state.q))
        for c, term in zip(self.coefficients, self.law.terms, strict=True):
            total = total + c * compiled(term)(lookup)
        # Where no temperature is known, the law adds nothing.
        return np.asarray(np.nan_to_num(total))

    def _quantity(self, name: str, state: State, model: TorqueModel) -> Evaluated:
        is_direction = name.startswith("sign(")
        symbol = catalogue_symbol(name[len("sign(") : -1] if is_direction else name)
        assert symbol is not None, name
        j = self.joint if symbol.joint is None else symbol.joint
        if is_direction:
            return np.asarray(state.sign[:, j])
        gear_ratio = gear_ratios(model.robot)[j]
        surface = model.surfaces[j]
        match symbol.name:
            case "q" | "dq" | "load":
                return np.asarray(getattr(state, symbol.name)[:, j])
            case "theta":
                return np.asarray(gear_ratio * state.q[:, j])
            case "sign_width":
                return USUAL_SIGN_WIDTH if surface is None else surface.sign_width
            case "rotor":
                rotor = 0.0 if model.rotor is None else float(model.rotor[j])
                return float(gear_ratio**2 * rotor)
            case "load_is_modelled":
                return 1.0
            case "coulomb_share":
                return _coulomb_share(surface, state.q[:, j])
        if state.celsius is None:
            return np.full(len(state.q), np.nan)
        return np.asarray(state.celsius[:, j])


def _coulomb_share(surface: FrictionSurface | None, q: Array) -> Evaluated:
    """Return Coulomb friction (B,) at places over its mean, 1 where none is known."""
    if surface is None or len(surface.speeds) == 0:
        return 1.0
    mean = surface.mean_coulomb(PLACES)
    if mean <= 0.0:
        return 1.0
    low, high = surface.scaling.position
    return np.asarray(surface.coulomb(np.clip(q, low, high)) / mean)


@dataclass(frozen=True, kw_only=True)
class ArmEffects:
    """The effects of a file, sorted by how they take part.

    Attributes
    ----------
    model : TorqueModel
        The arm with what effects change of its bodies.
    armature : (n,) array
        kg m^2 that they add at the joints.
    torques : tuple of EffectTorque
        Those that act at every state.
    measured : tuple of FittedEffect
        Those that distort the measured torque.
    left_out : tuple of str
        Why others take no part, by name.
    """

    model: TorqueModel
    armature: Array
    torques: tuple[EffectTorque, ...] = ()
    measured: tuple[FittedEffect, ...] = ()
    left_out: tuple[str, ...] = ()

    @classmethod
    def none(cls, model: TorqueModel) -> "ArmEffects":
        """Return those of a file without any."""
        return cls(model=model, armature=np.zeros(model.robot.n))

    def added_to_table(self, joint: int) -> AddedFriction | None:
        """Return the friction that effects add at a joint's own states."""
        own = [
            each
            for each in self.torques
            if each.joint == joint and each.stands_in_table
        ]
        if not own:
            return None
        n = self.model.robot.n

        def added(q: Array, v: Array, sign: float) -> Array:
            q_all = np.zeros((len(q), n))
            q_all[:, joint] = q
            v_all = np.zeros((len(q), n))
            v_all[:, joint] = v
            state = State(
                q=q_all,
                dq=v_all,
                load=np.zeros_like(q_all),
                sign=np.full_like(q_all, sign),
            )
            return np.asarray(sum(each.torque(state, self.model) for each in own))

        return added

    def of_steps(self, load_friction: Array) -> tuple[EffectTorque, ...]:
        """Return those that are evaluated at every step.

        Parameters
        ----------
        load_friction : (n,) array
            N m per N m, what the windows of a drive have told of each joint's friction
            by its load. Where it is not zero it stands for the file's effect, which
            would count twice.
        """
        return tuple(
            each
            for each in self.torques
            if not each.stands_in_table
            and not (each.name == FRICTION_OF_LOAD and load_friction[each.joint] > 0.0)
        )

    def restored(self, log: Recording) -> Recording:
        """Return a log with its torque as it was before effects distorted it."""
        if log.tau is None:
            return log
        for item in self.measured:
            number = place_of(log, item.session).log if item.session else 0
            if acts_in_log(number, item.settings):
                assert isinstance(item.effect, TorqueMeasurement)
                log = item.effect.restored(
                    log, self.model.robot, item.joint, item.settings, item.coefficients
                )
        return log

    def along(self, q: Array, dq: Array, load: Array) -> Array:
        """Return the torque (N, n) N m of all effects along a motion."""
        widths = np.array(
            [
                USUAL_SIGN_WIDTH if surface is None else surface.sign_width
                for surface in self.model.surfaces
            ]
        )
        state = State(q=q, dq=dq, load=load, sign=np.tanh(dq / widths))
        total = np.zeros_like(q)
        for each in self.torques:
            bristle: Evaluated = 0.0
            if each.bristles is not None:
                bristle = deflection(q[:, each.joint], each.bristles.distance)
            total[:, each.joint] += each.torque(state, self.model, bristle)
        return total


def arm_effects(stages: Stages, robot: Robot) -> ArmEffects:
    """Sort the effects of a file by how they take part in a simulation."""
    model = TorqueModel.from_stages(stages, robot)
    armature = np.zeros(robot.n)
    torques: list[EffectTorque] = []
    measured = []
    left_out = []
    for entry in stages.effects or []:
        if entry.effect == UNEXPLAINED:
            left_out.append(
                f"a smooth term at {entry.joint} is not simulated: it has no cause that"
                " a simulated state knows"
            )
    for item in fitted_effects(stages, robot):
        assert isinstance(item, FittedEffect)
        effect = item.effect
        if isinstance(effect, TorqueMeasurement):
            measured.append(item)
            continue
        bodies = effect.body_terms(robot, item.joint, item.settings)
        laws = effect.laws(robot, item.joint, item.settings)
        reason = _reason_to_leave_out(item, bodies, laws)
        if reason:
            at = "" if item.joint is None else f" at {robot.name_of(item.joint)}"
            left_out.append(f"{effect.name}{at} is not simulated: {reason}")
            continue
        for c, term in zip(item.coefficients, bodies or (), strict=False):
            model = _with_body(model, term, float(c))
            if term.armature is not None:
                armature = armature + c * term.armature
        for j, law in (laws or {}).items():
            (bristles,) = [*law.memories.values(), None][:1]
            torques.append(
                EffectTorque(
                    name=effect.name,
                    joint=j,
                    law=law,
                    coefficients=item.coefficients,
                    bristles=bristles if isinstance(bristles, Bristles) else None,
                )
            )
    return ArmEffects(
        model=model,
        armature=armature,
        torques=tuple(torques),
        measured=tuple(measured),
        left_out=tuple(left_out),
    )


def _reason_to_leave_out(
    item: FittedEffect,
    bodies: Sequence[BodyTerm] | None,
    laws: Mapping[int, Law] | None,
) -> str:
    """Say why an effect takes no part; empty where it does."""
    effect = item.effect
    if effect.family == "measurement":
        return "it is of the measurement, and moves no arm"
    if bodies is not None:
        if any(term.rotor is not None for term in bodies):
            return "rotors that turn the links before their joints are not simulated"
        return ""
    if laws is None:
        return "joint and encoder move apart by it, and a simulated joint is one"
    for law in laws.values():
        if any(not isinstance(each, Bristles) for each in law.memories.values()):
            return "it follows from what was before, and not from the state"
        unknown = {symbol.name for symbol in law.symbols} - KNOWN
        if unknown:
            return f"a simulated state does not know {', '.join(sorted(unknown))}"
    return ""


def _with_body(model: TorqueModel, term: BodyTerm, c: float) -> TorqueModel:
    """Return the arm with what one coefficient changes of its bodies."""
    assert model.phi is not None
    phi = model.phi.copy()
    phi[-1] += c * term.last_link
    robot = model.robot
    # A simulated base is tilted by gravity that points elsewhere.
    robot = replace(robot, gravity=robot.gravity - c * term.gravity)
    return replace(model, phi=phi, robot=robot)
