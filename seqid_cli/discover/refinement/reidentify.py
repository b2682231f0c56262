"""The whole model anew, with effects in it, under either of two accounts of an effect.

*All along*: it was there when the earlier stages were identified, and has biased them. Effects and
base are fitted together on the training logs. The base is free where those stages have taken in
what looked like friction in their trials. Then the effects' torque is taken out of all recordings,
friction trials as well, and every stage runs again on them by its own recipe. This repeats until
the effects settle. Where the logs of the earlier stages are not at hand, the base moves as the
joint fit on the training logs says.

*Late*: it came with the training logs. The stages stay as they are, and only the effects are
fitted, beside a base that may move within the errors that the file gives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import msgspec
import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Candidate, Stage
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import motions_of, scenes_of, shared_starts
from seqid_cli.discover.select.model import FIRM, FREE, HELD, Ground, Hold, Model
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.parameters import representative_of
from seqid_cli.identify.rigid.simultaneous import TERMS, identify_simultaneous, surface_entries
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import session_of, without_effects
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import FrictionJoint, FrictionStage, RigidStage, Stages
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LOOSE = 3.0  # variance of a direction over that of its parameters, from which it may be held
CLEAR = 2.0  # standard errors, that such a direction must move by to leave the file
TURNS = 6  # of effects and stages, at most
SETTLED = 0.3  # standard errors, that coefficients still move by when they have settled
STALLED = 0.7  # of the step before: larger ones never settle, logs of earlier stages contradict
MOVES = 0.01  # of a joint's largest travel, from which a log is one of its own

Key = tuple[str, int | None]  # name of an effect, and its joint


@dataclass(frozen=True)
class Refitted:
    """A model with effects: the stages without them, the effects, and which of these came late."""

    stages: Stages
    effects: tuple[Fitted, ...]
    late: frozenset[Key] = frozenset()

    @property
    def lasting(self) -> list[Fitted]:
        """Effects that were there all along."""
        return [f for f in self.effects if key_of(f) not in self.late]


def key_of(fitted: Fitted) -> Key | None:
    """What tells a fitted effect from the others; None for a smooth term."""
    return (fitted.effect.name, fitted.joint) if isinstance(fitted, FittedEffect) else None


@dataclass(frozen=True)
class Material:
    """What a model is identified from.

    `earlier` are the logs of the earlier stages, by stage; empty where they are not at hand.
    """

    training: tuple[Recording, ...]
    earlier: Mapping[str, Sequence[Recording]]
    robot: Robot
    options: DiscoverOptions
    _motions: list[Motion] = field(init=False, default_factory=list, compare=False, repr=False)

    def scenes(self, stages: Stages) -> list[Scene]:
        """Data sets of the training logs; their motion is the same whatever the model."""
        options = self.options.motion
        if not self._motions:
            found = motions_of(self.training, self.robot, stages, options=options)
            self._motions.extend(found)
        return scenes_of(self.training, self.robot, stages, options=options, motions=self._motions)

    def freed(
        self, logs: Sequence[Recording], stages: Stages, effects: Sequence[Fitted]
    ) -> list[Recording]:
        """The logs without the effects' torque."""
        motion = self.options.motion
        return [
            without_effects(
                log, self.robot, stages, effects, motion=motion.motion, source=motion.source
            )
            for log in logs
        ]

    def before(self, stage: str, model: Refitted) -> list[Recording]:
        """The logs of an earlier stage without what was there all along, each once.

        Those that are fitted are left to `now`.
        """
        fitted = {identity(log) for log in self.training}
        logs = [x for x in unique(self.earlier.get(stage, ())) if identity(x) not in fitted]
        return self.freed(logs, model.stages, model.lasting)

    def now(self, model: Refitted) -> list[Recording]:
        """The training logs without any effect."""
        return self.freed(self.training, model.stages, model.effects)

    def before_or_now(self, stage: str, model: Refitted) -> list[Recording]:
        """All logs of an earlier stage; those that are fitted as well, without any effect."""
        own = {identity(log) for log in self.earlier.get(stage, ())}
        fitted = [log for log in self.training if identity(log) in own]
        return [*self.before(stage, model), *self.freed(fitted, model.stages, model.effects)]

    def as_they_were(self, stage: str, freed: Sequence[Recording]) -> bool:
        """Whether logs of an earlier stage are still what it was identified from."""
        logs = {identity(log): log for log in self.earlier.get(stage, ())}
        return len(logs) == len(freed) and not any(
            _changed(logs[identity(log)], log).any()
            or not np.array_equal(logs[identity(log)].valid, log.valid)
            for log in freed
        )

    @property
    def known(self) -> bool:
        """Whether the file was identified from all of the training logs."""
        logs = {identity(log) for stage in self.earlier.values() for log in stage}
        return all(identity(log) in logs for log in self.training)


def refitted(
    material: Material,
    model: Refitted,
    candidates: Sequence[Candidate],
    *,
    late: frozenset[Key],
    kept: bool,
) -> Refitted:
    """Fit effects and model together.

    Parameters
    ----------
    material : Material
    model : Refitted
        The model as it stands.
    candidates : sequence of Candidate
        All effects that it is to have; none is a model identified anew.
    late : frozenset of Key
        Those of them that the logs of the earlier stages do not have.
    kept : bool
        Whether the stages are right as they are, and only the effects are fitted.
    """
    stages = model.stages
    if not kept:
        stages, candidates = _in_turns(material, stages, candidates, late)
    if not candidates:
        return Refitted(stages, (), late)
    fit = _fitted(material, stages, candidates, HELD)
    # Their errors are beside a base that may move; but it is the file's that they are written to.
    effects = _effects_of(material, fit)
    fit.hold = FIRM
    fit.settle()
    values = [x.coefficients for x in _effects_of(material, fit)]
    pairs = zip(effects, values, strict=True)
    return Refitted(stages, tuple(replace(x, coefficients=c) for x, c in pairs), late)


def _in_turns(
    material: Material,
    stages: Stages,
    candidates: Sequence[Candidate],
    late: frozenset[Key],
) -> tuple[Stages, Sequence[Candidate]]:
    """Fit effects, then identify the stages without them, until the effects settle."""
    before, effects, step = list[FittedEffect](), list[FittedEffect](), np.inf
    for _ in range(TURNS):
        fit = cache(partial(_fitted, material, stages, candidates, FREE))
        if candidates:
            before, effects = effects, _effects_of(material, fit())
        stages = _stages(material, Refitted(stages, tuple(effects), late), fit)
        if not candidates:
            break
        candidates = fit().candidates
        last, step = step, _step(before, effects) if before else np.inf
        if step <= SETTLED or step > STALLED * last:
            break
    return stages, candidates


def _step(before: Sequence[FittedEffect], after: Sequence[FittedEffect]) -> float:
    """By how many of their standard errors coefficients have moved, at most."""
    return max(
        float(np.max(np.abs(new.coefficients - old.coefficients) / _errors(new)))
        for old, new in zip(before, after, strict=True)
    )


def _errors(effect: FittedEffect) -> Array:
    return np.sqrt(np.maximum(np.diag(effect.covariance), 1e-300))


def _fitted(
    material: Material, stages: Stages, candidates: Sequence[Candidate], hold: Hold
) -> Model:
    """Base and effects fitted to the training logs, settings searched once more."""
    rows = rows_of(material.scenes(stages))
    fit = Model(Ground.of(Stage(rows), base_of(rows, stages)), hold)
    fit.add(candidates)
    return fit


def _effects_of(material: Material, fit: Model) -> list[FittedEffect]:
    """The effects with their coefficients, and errors no narrower than the scatter over blocks."""
    starts, shared = shared_starts(material.training)
    session = session_of(material.training, starts, shared)
    return [
        FittedEffect(
            what.effect,
            what.joint,
            what.settings,
            fit.coefficients(term),
            fit.covariance(term),
            session,
        )
        for term, what in zip(fit.terms, fit.candidates, strict=True)
    ]


def _stages(material: Material, model: Refitted, fit: Callable[[], Model]) -> Stages:
    """Every stage again, on logs without the effects; `fit` where stages move as it says."""
    robot, motion, stages = material.robot, material.options.motion, model.stages
    friction, earlier = stages.friction, material.earlier
    if friction is not None and friction.method == "simultaneous":
        freed = [*material.before("friction", model), *material.now(model)]
        offset = any(len(j.parameters) == len(TERMS) for j in friction.joints.values())
        new, inertia = identify_simultaneous(freed, robot, options=motion.motion, offset=offset)
        found = Stages(friction=new, imu=stages.imu, inertia=inertia)
        return held(found, stages, fit()) if material.known else found
    needed = [s for s in ("friction", "gravity", "inertia") if getattr(stages, s) is not None]
    if all(earlier.get(stage) for stage in needed):
        return _sequential(material, model)
    joint = fit()
    return moved(stages, joint, joint.linear.theta)


def _sequential(material: Material, model: Refitted) -> Stages:
    robot, motion, stages = material.robot, material.options.motion, model.stages
    new = Stages(friction=stages.friction, gravity=stages.gravity, imu=stages.imu)
    new.inertia = stages.inertia
    if stages.friction is not None:
        new.friction = _friction(material, model, stages.friction)
    if stages.gravity is not None:
        freed = material.before_or_now("gravity", model)
        if new.friction is not stages.friction or not material.as_they_were("gravity", freed):
            new.gravity = identify_gravity(freed, robot, new)
    if stages.inertia is not None:
        freed = [*material.before("inertia", model), *material.now(model)]
        new.inertia = identify_inertia(freed, robot, new, options=motion)
    return new


def _friction(material: Material, model: Refitted, old: FrictionStage) -> FrictionStage:
    """Friction again, of the joints whose torque or position the effects change in its logs."""
    robot = material.robot
    freed = material.before_or_now("friction", model)
    known = {identity(log): log for log in material.earlier["friction"]}
    changed = np.any([_changed(known[identity(log)], log) for log in freed], axis=0)
    travel = np.array([np.ptp(log.q, axis=0) for log in freed])
    moves = travel > MOVES * travel.max(axis=0)
    logs = [log for log, moving in zip(freed, moves, strict=True) if np.any(moving & changed)]
    names = {name for name, anew in zip(robot.joint_names, changed, strict=True) if anew}
    if not logs:
        return old
    new = identify_friction(logs, robot, options=FrictionOptions())
    joints = {n: j for n, j in new.joints.items() if n in names}
    verdicts = [v for v in new.verdicts if v.joint in names]
    return msgspec.structs.replace(
        old,
        joints=old.joints | joints,  # in the file's order
        verdicts=[*(v for v in old.verdicts if v.joint not in names), *verdicts],
        notes=list(dict.fromkeys([*old.notes, *new.notes])),
    )


def _changed(log: Recording, freed: Recording) -> NDArray[np.bool_]:
    """Joints (n,) whose torque or position the effects have changed."""
    assert log.tau is not None
    assert freed.tau is not None
    changed: NDArray[np.bool_] = np.any((log.tau != freed.tau) | (log.q != freed.q), axis=0)
    return changed


def unique(logs: Sequence[Recording]) -> list[Recording]:
    """Logs in their order, each once."""
    return list({identity(log): log for log in logs}.values())


def identity(log: Recording) -> tuple[str, str]:
    """What tells a log from others."""
    return log.sha256, str(log.path)


def held(new: Stages, old: Stages, fit: Model) -> Stages:
    """Simultaneous stages without what moved by less than its error, where logs hardly tell it.

    Directions that these logs leave loose would wander with every effect that is added. `fit` is of
    the same logs, and `old` are the stages before.
    """
    before, after = (_values(stages, fit) for stages in (old, new))
    error = after[1]
    at = np.flatnonzero((error > 0.0) & (before[1] > 0.0))
    if not len(at):
        return new
    white = fit.linear.covariance[np.ix_(at, at)].copy()
    white *= float(np.median(error[at] ** 2 / np.diag(white)))
    scale = np.sqrt(np.diag(white))
    variance, direction = np.linalg.eigh(white / np.outer(scale, scale))
    change = direction.T @ ((after[0] - before[0])[at] / scale)
    undone = np.where((change**2 < CLEAR**2 * variance) & (variance > LOOSE), change, 0.0)
    theta = np.zeros(fit.linear.size)
    theta[at] = -scale * (direction @ undone)
    return moved(new, fit, theta)


def _values(stages: Stages, fit: Model) -> tuple[Array, Array]:
    """Values and standard errors of simultaneous stages, as the base's columns are ordered."""
    names, where = fit.ground.stage.scenes[0].robot.joint_names, fit.linear.where
    values, errors = np.zeros((2, where[len(names)].stop))
    rigid = {p.name: p for p in (stages.inertia.parameters if stages.inertia else ())}
    for k, name in enumerate(fit.ground.base.basis.names):
        if name in rigid:
            values[k], errors[k] = rigid[name].value, rigid[name].std_error
    for name, own in zip(names, where[1:], strict=False):
        joint = stages.friction.joints.get(name) if stages.friction else None
        if joint is not None and joint.parameters:
            values[own] = [p.value for p in joint.parameters]
            errors[own] = [p.std_error for p in joint.parameters]
    return values, errors


def moved(stages: Stages, fit: Model, theta: Array) -> Stages:
    """The stages with deviations of the base, ordered as `fit` has them, added to what they say."""
    robot, where = fit.ground.stage.scenes[0].robot, fit.linear.where
    n = robot.n
    friction = None
    if stages.friction is not None:
        joints = dict(stages.friction.joints)
        for j, name in enumerate(robot.joint_names):
            if name in joints:
                joints[name] = _moved_friction(joints[name], theta[where[1 + j]])
        friction = msgspec.structs.replace(stages.friction, joints=joints)
    rigid = fit.ground.base.basis
    change = theta[where[0]]
    result = Stages(friction=friction, imu=stages.imu)
    values = dict(zip(rigid.names, change, strict=True))
    for name in ("gravity", "inertia"):
        stage = getattr(stages, name)
        if stage is not None:
            setattr(result, name, _moved_rigid(stage, values))
    last = result.inertia or result.gravity
    if last is not None:
        now = np.array([last.representative.get(x, 0.0) for x in standard_names(n)])
        added = representative_of(rigid, change, np.zeros(n))
        total = now + np.array([added.get(x, 0.0) for x in standard_names(n)])
        names = standard_names(n)
        last.representative = {x: float(v) for x, v in zip(names, total, strict=True) if v != 0.0}
    return result


def _moved_rigid(stage: RigidStage, change: Mapping[str, float]) -> RigidStage:
    parameters = [
        msgspec.structs.replace(p, value=float(p.value + change.get(p.name, 0.0)))
        for p in stage.parameters
    ]
    return msgspec.structs.replace(
        stage, parameters=parameters, representative=dict(stage.representative)
    )


def _moved_friction(joint: FrictionJoint, change: Array) -> FrictionJoint:
    """A surface whose entries moved; of a simultaneous fit the parameters as well."""
    positive, negative = np.array(joint.positive), np.array(joint.negative)
    size = positive.size
    if joint.parameters:
        return _moved_simple(joint, change)
    positive = positive + change[:size].reshape(positive.shape)
    other = change[size : 2 * size] if joint.directional else change[:size]
    negative = negative + other.reshape(negative.shape)
    return msgspec.structs.replace(joint, positive=positive.tolist(), negative=negative.tolist())


def _moved_simple(joint: FrictionJoint, change: Array) -> FrictionJoint:
    ahead, back = surface_entries(joint.speed_range[1], len(change))
    parameters = [
        msgspec.structs.replace(p, value=float(p.value + c))
        for p, c in zip(joint.parameters, change, strict=True)
    ]
    return msgspec.structs.replace(
        joint,
        positive=(np.array(joint.positive) + (ahead @ change)[None]).tolist(),
        negative=(np.array(joint.negative) + (back @ change)[None]).tolist(),
        parameters=parameters,
    )
