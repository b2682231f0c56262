"""The whole model anew, with effects in it, under either of two accounts of an effect.

*All along*: it was there when the earlier stages were identified, and has biased them.
Effects and base are fitted together on the training logs. The base is free where those
stages have taken in what looked like friction in their trials. Then the effects' torque
is taken out of all recordings, friction trials as well, and every stage runs again on
them by its own recipe. Where the logs of the earlier stages are not at hand, the base
moves as the joint fit on the training logs says.

*Late*: it came with the training logs. The stages stay as they are, and only the
effects are fitted, beside a base that may move within the errors that the file gives.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from msgspec import structs

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import scenes_of, shared_starts
from seqid_cli.discover.select.model import FIRM, FREE, HELD, Ground, Model
from seqid_cli.discover.select.results import Key
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import smooth_term
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.parameters import representative_of
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.identify.rigid.simultaneous_equations import (
    FRICTION_TERMS,
    surface_entries,
)
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import session_of, without_effects
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.effects.smooth import SmoothTerm
from seqid_cli.params.schema import FrictionJoint, FrictionStage, RigidStage, Stages
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

# variance of a direction over that of its parameters, from which it may be held
LOOSE = 3.0
CLEAR = 2.0  # standard errors, that such a direction must move by to leave the file


def held(new: Stages, old: Stages, fit: Model) -> Stages:
    """Simultaneous stages without what moved by less than its error, where logs hardly tell it.

    Directions that these logs leave loose would wander with every effect that is added.
    `fit` is of the same logs, and `old` are the stages before.
    """
    (before, known), (after, error) = (_values(stages, fit) for stages in (old, new))
    at = np.flatnonzero((error > 0.0) & (known > 0.0))
    if not len(at):
        return new
    white = fit.linear.covariance[np.ix_(at, at)].copy()
    white *= float(np.median(error[at] ** 2 / np.diag(white)))
    scale = np.sqrt(np.diag(white))
    variance, direction = np.linalg.eigh(white / np.outer(scale, scale))
    change = direction.T @ ((after - before)[at] / scale)
    undone = np.where(
        (change**2 < CLEAR**2 * variance) & (variance > LOOSE), change, 0.0
    )
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
    result, basis, change = (
        Stages(imu=stages.imu),
        fit.ground.base.basis,
        theta[where[0]],
    )
    if stages.friction is not None:
        joints = dict(stages.friction.joints)
        for name, own in zip(robot.joint_names, where[1:], strict=False):
            if name in joints:
                joints[name] = _moved_friction(joints[name], theta[own])
        result.friction = structs.replace(stages.friction, joints=joints)
    more = dict(zip(basis.names, change, strict=True))

    def moved_rigid(stage: RigidStage | None) -> RigidStage | None:
        if stage is None:
            return None
        own = [
            structs.replace(p, value=float(p.value + more.get(p.name, 0.0)))
            for p in stage.parameters
        ]
        return structs.replace(
            stage, parameters=own, representative=dict(stage.representative)
        )

    result.gravity, result.inertia = (
        moved_rigid(stages.gravity),
        moved_rigid(stages.inertia),
    )
    last = result.inertia or result.gravity
    if last is not None:
        now, added = (
            last.representative,
            representative_of(basis, change, np.zeros(robot.n)),
        )
        total = {
            x: now.get(x, 0.0) + added.get(x, 0.0) for x in standard_names(robot.n)
        }
        last.representative = {x: float(v) for x, v in total.items() if v != 0.0}
    return result


def _moved_friction(joint: FrictionJoint, change: Array) -> FrictionJoint:
    """A surface whose entries moved; of a simultaneous fit the parameters as well."""
    positive, negative = np.array(joint.positive), np.array(joint.negative)
    size, parameters = positive.size, joint.parameters
    if parameters:
        ahead, back = (
            own @ change for own in surface_entries(joint.speed_range[1], len(change))
        )
        pairs = zip(parameters, change, strict=True)
        parameters = [structs.replace(p, value=float(p.value + c)) for p, c in pairs]
    else:
        ahead, back = (
            change[:size],
            change[size : 2 * size] if joint.directional else change[:size],
        )
    return structs.replace(
        joint,
        positive=(positive + ahead.reshape(positive.shape)).tolist(),
        negative=(negative + back.reshape(negative.shape)).tolist(),
        parameters=parameters,
    )


MOVES = 0.01  # of a joint's largest travel, from which a log is one of its own


@dataclass(frozen=True, eq=False)
class Refitted:
    """A model with effects: the stages without them, the effects, and which of these came late."""

    stages: Stages
    effects: tuple[Fitted, ...]
    late: frozenset[Key] = frozenset()

    @property
    def lasting(self) -> list[Fitted]:
        """Effects that were there all along."""
        return [f for f in self.effects if key_of(f) not in self.late]

    @property
    def candidates(self) -> list[Candidate]:
        """Its effects as candidates, to be fitted again."""
        known = (f for f in self.effects if isinstance(f, FittedEffect))
        return [
            Candidate(f.effect, f.joint, dict(f.settings), apart=f.effect.wide)
            for f in known
        ]


def key_of(fitted: Fitted) -> Key | None:
    """What tells a fitted effect from the others; None for a smooth term."""
    return (
        (fitted.effect.name, fitted.joint) if isinstance(fitted, FittedEffect) else None
    )


@dataclass(frozen=True)
class Material:
    """What a model is identified from; `earlier` are the logs at hand of the earlier stages."""

    training: tuple[Recording, ...]
    earlier: Mapping[str, Sequence[Recording]]
    robot: Robot
    options: DiscoverOptions
    _grounds: list[tuple[Stages, Ground]] = field(
        init=False, default_factory=list, compare=False, repr=False
    )

    def ground(self, stages: Stages) -> Ground:
        """Rows of the training logs with the base of these stages; the last two are kept."""
        known = next((pair for pair in self._grounds if pair[0] is stages), None)
        others = [pair for pair in self._grounds if pair is not known]
        if known is None:
            options = self.options.motion
            rows = rows_of(
                scenes_of(self.training, self.robot, stages, options=options)
            )
            known = stages, Ground.of(rows, stages)
        self._grounds[:] = [known, *others[:1]]
        return known[1]

    def without(
        self, log: Recording, stages: Stages, effects: Sequence[Fitted]
    ) -> Recording:
        """A log without the torque of some effects."""
        options, given = self.options.motion, (log, self.robot, stages, effects)
        return without_effects(*given, motion=options.motion, source=options.source)

    def freed(self, log: Recording, model: Refitted) -> Recording:
        """A log without effects: any, if it is fitted, else those that were there all along."""
        fitted = identity(log) in map(identity, self.training)
        return self.without(
            log, model.stages, model.effects if fitted else model.lasting
        )

    def now(self, model: Refitted) -> list[Recording]:
        """The training logs without any effect."""
        return [self.freed(log, model) for log in self.training]

    def logs_of(self, stage: str) -> list[Recording]:
        """The logs of an earlier stage, each once; those that are fitted last."""
        fitted = {identity(log) for log in self.training}
        return sorted(
            unique(self.earlier.get(stage, ())), key=lambda log: identity(log) in fitted
        )

    @property
    def known(self) -> bool:
        """Whether the file was identified from all of the training logs."""
        logs = {identity(log) for stage in self.earlier.values() for log in stage}
        return all(identity(log) in logs for log in self.training)


def changed_joints(log: Recording, freed: Recording) -> Mask:
    """Joints (n,) whose torque or position the effects have changed."""
    assert log.tau is not None
    assert freed.tau is not None
    return np.asarray(np.any((log.tau != freed.tau) | (log.q != freed.q), axis=0))


def unique(logs: Sequence[Recording]) -> list[Recording]:
    """Logs in their order, each once."""
    return list({identity(log): log for log in logs}.values())


def identity(log: Recording) -> tuple[str, str]:
    """What tells a log from others."""
    return log.sha256, str(log.path)


def refitted(
    material: Material,
    model: Refitted,
    candidates: Sequence[Candidate],
    *,
    late: frozenset[Key],
    kept: bool,
) -> Refitted:
    """Fit effects and model together.

    `candidates` are all effects that the model is to have; none is a model identified
    anew. `late` are those of them that the logs of the earlier stages do not have.
    `kept`: the stages are right as they are, and only the effects are fitted.
    """
    stages = model.stages
    if not candidates:
        bare = Refitted(stages, (), late)
        return bare if kept else replace(bare, stages=_stages(material, bare, None))
    fit = Model(material.ground(stages), HELD if kept else FREE, candidates)
    if not kept:
        freed = Refitted(stages, tuple(_effects_of(material, fit)), late)
        stages = _stages(material, freed, fit)
        plain = [replace(x, absorbed="") for x in fit.candidates]
        fit = Model(material.ground(stages), FREE, plain)
    # Effects as they are beside exactly these stages; their errors are beside a base
    # that may move.
    firm = copy(fit)
    firm.hold = FIRM
    firm.settle()
    pairs = zip(
        _effects_of(material, fit), map(firm.coefficients, firm.terms), strict=True
    )
    return Refitted(stages, tuple(replace(x, coefficients=c) for x, c in pairs), late)


def fitted_smooth(
    material: Material, model: Refitted, what: SmoothFunction
) -> SmoothTerm:
    """Fit a smooth term to what a model with its effects leaves of the training logs.

    It is fitted beside exactly these stages, which stay as they are: beside a base that
    moves it would count on what the base has moved by.
    """
    scenes = scenes_of(
        material.now(model),
        material.robot,
        model.stages,
        options=material.options.motion,
    )
    fit = Model(Ground.of(rows_of(scenes), model.stages), FIRM)
    term = smooth_term(fit.ground.stage, what, fit.ground.size)
    fit.terms.append(term)
    fit.settle()
    return what.fitted(fit.coefficients(term)[: what.size])


def _effects_of(material: Material, fit: Model) -> list[FittedEffect]:
    """The effects with their coefficients, and errors no narrower than the scatter over blocks."""
    session, found = (
        session_of(material.training, *shared_starts(material.training)),
        [],
    )
    for term, x in zip(fit.terms, fit.candidates, strict=True):
        values = fit.coefficients(term), fit.covariance(term)
        found.append(FittedEffect(x.effect, x.joint, x.settings, *values, session))
    return found


def _stages(material: Material, model: Refitted, fit: Model | None) -> Stages:
    """Every stage again, on logs without the effects, or else as `fit`, or a free base, moves."""
    robot, stages, friction = material.robot, model.stages, model.stages.friction
    if friction is not None and friction.method == "simultaneous":
        logs = unique([*material.logs_of("friction"), *material.training])
        freed = [material.freed(log, model) for log in logs]
        offset = any(
            len(j.parameters) == len(FRICTION_TERMS) for j in friction.joints.values()
        )
        motion = material.options.motion.motion
        new, inertia = identify_simultaneous(
            freed, robot, options=motion, offset=offset
        )
        found = Stages(friction=new, imu=stages.imu, inertia=inertia)
        if not material.known:
            return found
        return held(found, stages, fit or Model(material.ground(stages), FREE))
    needed = [
        s for s in ("friction", "gravity", "inertia") if getattr(stages, s) is not None
    ]
    if all(material.earlier.get(stage) for stage in needed):
        return _sequential(material, model)
    joint = fit or Model(material.ground(stages), FREE)
    return moved(stages, joint, joint.linear.theta)


def _sequential(material: Material, model: Refitted) -> Stages:
    """Friction, gravity and inertia again."""
    robot, motion, stages = material.robot, material.options.motion, model.stages
    new = structs.replace(stages, effects=None)
    known = {identity(log): log for own in material.earlier.values() for log in own}
    now = known | {identity(log): log for log in material.training}
    freed = cache(lambda name: material.freed(now[name], model))
    friction, gravity, inertia = (  # each log as it is, and freed
        [(known[name], freed(name)) for name in map(identity, material.logs_of(stage))]
        for stage in ("friction", "gravity", "inertia")
    )
    if stages.friction is not None:
        new.friction = _friction(robot, friction, stages.friction)
    changed = new.friction is not stages.friction or any(
        changed_joints(log, own).any() or not np.array_equal(log.valid, own.valid)
        for log, own in gravity
    )
    if stages.gravity is not None and changed:
        result = identify_gravity([own for _, own in gravity], robot, new)
        new.gravity, new.friction = result.gravity, result.friction
    if stages.inertia is not None:
        every = [own for _, own in inertia] + [
            freed(identity(log)) for log in material.training
        ]
        found = identify_inertia(unique(every), robot, new, options=motion)
        new.inertia, new.friction = found.inertia, found.friction
    return new


def _friction(
    robot: Robot, logs: Sequence[tuple[Recording, Recording]], old: FrictionStage
) -> FrictionStage:
    """Friction again, of the joints whose torque or position the effects change in its logs."""
    changed = np.any([changed_joints(*both) for both in logs], axis=0)
    travel = np.array([np.ptp(own.q, axis=0) for _, own in logs])
    moves = travel > MOVES * travel.max(axis=0)
    moved = [
        own for (_, own), at in zip(logs, moves, strict=True) if np.any(at & changed)
    ]
    if not moved:
        return old
    names = {
        name for name, anew in zip(robot.joint_names, changed, strict=True) if anew
    }
    new = identify_friction(moved, robot, options=FrictionOptions())
    kept = [v for v in old.verdicts if v.joint not in names]
    return structs.replace(
        old,  # joints in the file's order
        joints=old.joints | {n: j for n, j in new.joints.items() if n in names},
        verdicts=[*kept, *(v for v in new.verdicts if v.joint in names)],
        notes=list(dict.fromkeys([*old.notes, *new.notes])),
    )
