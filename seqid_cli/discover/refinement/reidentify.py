"""The whole model anew, with effects in it, under either of two accounts of an effect.

*All along*: it was there when the earlier stages were identified, and has biased them.
Effects and base are fitted together on the training logs. The base is free where those
stages have taken in what looked like friction in their trials. Then the effects' torque
is taken out of all recordings, friction trials as well, and every stage runs again on
them by its own recipe. Where the logs of the earlier stages are not all at hand, the
base moves as the joint fit on the training logs says.

*Late*: it came with the training logs. The stages stay as they are, and only the
effects are fitted, beside a base that may move within the errors that the file gives.

Smooth terms that the model has stay as they are: effects and stages are fitted to what
they leave of the training logs.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from msgspec import structs

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.scenes import scenes_of, shared_starts
from seqid_cli.discover.select.model import FIRM, FREE, HELD, Model, SelectionProblem
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import smooth_term
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.apply import session_of, without_effects
from seqid_cli.effects.fitted import Fitted, FittedEffect
from seqid_cli.effects.smooth import SmoothTerm
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.recipe import friction_options, recipe_of, stage_settings
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.parameters import made_consistent, representative_of
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.identify.rigid.simultaneous_equations import (
    FRICTION_TERMS,
    surface_entries,
)
from seqid_cli.identify.settings import (
    FrictionSettings,
    GravitySettings,
    InertiaSettings,
    SimultaneousSettings,
)
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import (
    EffectSession,
    FrictionJoint,
    FrictionStage,
    RigidStage,
    Stages,
)
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

# variance of a direction over that of its parameters, from which it may be held
LOOSE = 3.0
CLEAR = 2.0  # standard errors, that such a direction must move by to leave the file
MOVES = 0.01  # of a joint's largest travel, from which a log is one of its own


# ---- models and what they are fitted to


@dataclass(frozen=True, eq=False)
class Refitted:
    """A model with effects.

    Attributes
    ----------
    stages : Stages
        The stages without the effects.
    effects : tuple of Fitted
        Effects and smooth terms.
    """

    stages: Stages
    effects: tuple[Fitted, ...]

    @property
    def lasting(self) -> list[Fitted]:
        """Effects that were there all along."""
        return [effect for effect in self.effects if not effect.late]

    @property
    def smooth_terms(self) -> tuple[SmoothTerm, ...]:
        """Its smooth terms."""
        return tuple(
            effect for effect in self.effects if isinstance(effect, SmoothTerm)
        )

    @property
    def candidates(self) -> list[Candidate]:
        """Its effects as candidates, to be fitted again."""
        return [
            Candidate(
                fitted.effect,
                fitted.joint,
                dict(fitted.settings),
                apart=fitted.effect.wide,
                late=fitted.late,
            )
            for fitted in self.effects
            if isinstance(fitted, FittedEffect)
        ]


class _Ground(NamedTuple):
    """The problem of the training logs beside stages and smooth terms of a model."""

    stages: Stages
    smooth_terms: tuple[SmoothTerm, ...]
    problem: SelectionProblem

    def is_of(self, model: Refitted) -> bool:
        """Return whether a model has the very same stages and smooth terms."""
        ids = [id(term) for term in self.smooth_terms]
        return self.stages is model.stages and ids == [
            id(term) for term in model.smooth_terms
        ]


@dataclass(frozen=True)
class RefinementData:
    """What a model is identified from.

    Attributes
    ----------
    training : tuple of Recording
        The logs that are fitted.
    earlier : mapping of str to sequence of Recording
        The logs at hand of the earlier stages, by stage.
    robot : Robot
        The arm.
    options : DiscoverOptions
        Where motion comes from.
    incomplete : frozenset of str
        Stages of which not all logs are at hand.
    """

    training: tuple[Recording, ...]
    earlier: Mapping[str, Sequence[Recording]]
    robot: Robot
    options: DiscoverOptions
    incomplete: frozenset[str] = frozenset()
    _grounds: list[_Ground] = field(
        init=False, default_factory=list, compare=False, repr=False
    )

    @property
    def selection_options(self) -> Options:
        """What decides, by the user's settings."""
        return Options.of(self.options.settings.evidence)

    def ground(self, model: Refitted) -> SelectionProblem:
        """Return the problem of the training logs beside the stages of a model.

        The torque of its smooth terms is taken off; that of its effects is in the logs.
        The last two problems are kept: they take most of the time.
        """
        latest = next((each for each in self._grounds if each.is_of(model)), None)
        earlier = [each for each in self._grounds if each is not latest]
        if latest is None:
            stages = model.stages
            smooth_terms = model.smooth_terms
            scenes = scenes_of(
                [self.without(log, stages, smooth_terms) for log in self.training],
                self.robot,
                stages,
                options=self.options.motion,
            )
            problem = SelectionProblem.of(
                rows_of(scenes), stages, self.selection_options
            )
            latest = _Ground(stages, smooth_terms, problem)
        self._grounds[:] = [latest, *earlier[:1]]
        return latest.problem

    def keep(self, model: Refitted, problem: SelectionProblem) -> None:
        """Keep the problem of the training logs beside a model for later."""
        self._grounds[:] = [_Ground(model.stages, model.smooth_terms, problem)]

    def without(
        self, log: Recording, stages: Stages, effects: Sequence[Fitted]
    ) -> Recording:
        """Return a log without the torque of some effects.

        Parameters
        ----------
        log : Recording
            The log.
        stages : Stages
            The model without the effects.
        effects : sequence of Fitted
            What is taken off.
        """
        options = self.options.motion
        return without_effects(
            log,
            self.robot,
            stages,
            effects,
            motion=options.motion,
            source=options.source,
        )

    def freed(self, log: Recording, model: Refitted) -> Recording:
        """Return a log without the effects that were there when it was recorded.

        Parameters
        ----------
        log : Recording
            In one that is fitted all effects were there, else those of all along.
        model : Refitted
            The effects, and stages without them.
        """
        is_fitted = identity(log) in map(identity, self.training)
        effects = model.effects if is_fitted else model.lasting
        return self.without(log, model.stages, effects)

    def now(self, model: Refitted) -> list[Recording]:
        """Return the training logs without any effect."""
        return [self.freed(log, model) for log in self.training]

    def logs_of(self, stage: str) -> list[Recording]:
        """Return the logs of an earlier stage, each once, the fitted ones last."""
        fitted = {identity(log) for log in self.training}
        return sorted(
            unique(self.earlier.get(stage, ())), key=lambda log: identity(log) in fitted
        )

    def is_at_hand(self, stage: str) -> bool:
        """Return whether all logs of an earlier stage are at hand.

        From a part of its trials a stage would be another one.
        """
        return bool(self.earlier.get(stage)) and stage not in self.incomplete

    @property
    def known(self) -> bool:
        """Whether the file was identified from all of the training logs."""
        of_file = {identity(log) for logs in self.earlier.values() for log in logs}
        return all(identity(log) in of_file for log in self.training)


def changed_joints(log: Recording, freed: Recording) -> Mask:
    """Return the joints (n,) whose torque or position the effects have changed."""
    assert log.tau is not None
    assert freed.tau is not None
    is_changed = (log.tau != freed.tau) | (log.q != freed.q)
    return np.asarray(np.any(is_changed, axis=0))


def unique(logs: Sequence[Recording]) -> list[Recording]:
    """Return logs in their order, each once."""
    return list({identity(log): log for log in logs}.values())


def identity(log: Recording) -> tuple[str, str]:
    """Return what tells a log from others."""
    return log.sha256, str(log.path)


# ---- fitting


def refitted(
    material: RefinementData,
    model: Refitted,
    candidates: Sequence[Candidate],
    *,
    kept: bool,
) -> Refitted:
    """Fit effects and model together.

    Parameters
    ----------
    material : RefinementData
        The logs.
    model : Refitted
        The model as it stands; its smooth terms stay.
    candidates : sequence of Candidate
        All effects that the model is to have; without any it is identified anew.
    kept : bool
        The stages are right as they are, and only the effects are fitted.
    """
    smooth_terms = model.smooth_terms
    bare = Refitted(model.stages, smooth_terms)
    if not candidates:
        if kept:
            return bare
        return replace(bare, stages=_stages(material, bare, None))

    fit = Model(material.ground(bare), HELD if kept else FREE, candidates)
    if not kept:
        # The effects' torque is taken out of all logs, and every stage runs again. The
        # new stages have absorbed nothing of them.
        with_effects = replace(
            bare, effects=(*_fitted_effects(material, fit), *smooth_terms)
        )
        fit.linear.forget_parts()
        bare = replace(bare, stages=_stages(material, with_effects, fit))
        unabsorbed = [replace(effect, absorbed="") for effect in fit.candidates]
        fit = Model(material.ground(bare), FREE, unabsorbed)

    # Effects as they are beside exactly these stages; their errors are beside a base
    # that may move.
    firm = copy(fit)
    firm.hold = FIRM
    firm.settle()
    effects = [
        replace(effect, coefficients=firm.coefficients(term))
        for effect, term in zip(_fitted_effects(material, fit), firm.terms, strict=True)
    ]
    return replace(bare, effects=(*effects, *smooth_terms))


def fitted_smooth(
    material: RefinementData, model: Refitted, function: SmoothFunction
) -> SmoothTerm:
    """Fit a smooth term to what a model with its effects leaves of the training logs.

    It is fitted beside exactly these stages, which stay as they are: beside a base that
    moves it would count on what the base has moved by.

    Parameters
    ----------
    material : RefinementData
        The logs.
    model : Refitted
        The model.
    function : SmoothFunction
        The term's quantities, and its combinations of splines.
    """
    scenes = scenes_of(
        material.now(model),
        material.robot,
        model.stages,
        options=material.options.motion,
    )
    ground = SelectionProblem.of(
        rows_of(scenes), model.stages, material.selection_options
    )
    fit = Model(ground, FIRM)
    # The stages are what they are: what they have absorbed is no part of it.
    beside_stages = replace(function, absorbed=False)
    term = smooth_term(fit.ground.stage, beside_stages, fit.ground.size)
    fit.terms.append(term)
    fit.settle()
    fitted = function.fitted(fit.coefficients(term)[: function.size])
    return replace(fitted, session=_session(material))


def _fitted_effects(material: RefinementData, fit: Model) -> list[FittedEffect]:
    """Return the effects of a model with their coefficients.

    Errors are no narrower than the coefficients scatter over blocks.
    """
    session = _session(material)
    return [
        FittedEffect(
            effect=candidate.effect,
            joint=candidate.joint,
            settings=candidate.settings,
            coefficients=fit.coefficients(term),
            covariance=fit.covariance(term),
            session=session,
            late=candidate.late,
        )
        for term, candidate in zip(fit.terms, fit.candidates, strict=True)
    ]


def _session(material: RefinementData) -> EffectSession:
    """Return the training logs, as times and numbers of logs count in effects."""
    starts, is_shared = shared_starts(material.training)
    return session_of(material.training, starts, is_shared)


# ---- every stage again


def _stages(material: RefinementData, model: Refitted, fit: Model | None) -> Stages:
    """Identify every stage again by its recipe, on logs without the effects.

    Where the logs of the stages are not all at hand, the base moves as `fit` says, or
    as a free base without effects.
    """
    stages = model.stages
    needed = [
        stage
        for stage in ("friction", "gravity", "inertia")
        if getattr(stages, stage) is not None
    ]
    is_one_step = (
        stages.friction is not None and stages.friction.method == "simultaneous"
    )
    if is_one_step:
        new = _simultaneous(material, model, fit)
    elif all(material.is_at_hand(stage) for stage in needed):
        new = _sequential(material, model)
    else:
        moving = fit or Model(material.ground(model), FREE)
        new = moved(stages, moving, moving.linear.theta)

    # As the stages were asked for, and so that they can be identified alike again.
    if new.inertia is not None and recipe_of(stages.inertia).consistent:
        before = Stages() if is_one_step else new
        new.inertia = made_consistent(new.inertia, before, material.robot)
    for name in needed:
        old_stage = getattr(stages, name)
        new_stage = structs.replace(
            getattr(new, name), settings=old_stage.settings, recipe=old_stage.recipe
        )
        setattr(new, name, new_stage)
    return new


def _simultaneous(
    material: RefinementData,
    model: Refitted,
    fit: Model | None,
) -> Stages:
    """Identify friction and rigid body again, in one step."""
    stages = model.stages
    assert stages.friction is not None
    assert stages.inertia is not None
    logs_of_stage = material.logs_of("friction")
    has_offset = any(
        len(joint.parameters) == len(FRICTION_TERMS)
        for joint in stages.friction.joints.values()
    )
    options = _inertia_options(material, stages.inertia, logs_of_stage)
    new_friction, inertia = identify_simultaneous(
        [
            material.freed(log, model)
            for log in unique([*logs_of_stage, *material.training])
        ],
        material.robot,
        options=options.motion,
        offset=has_offset,
        imu=stages.imu,
        source=options.source,
        source_by_log=options.source_by_log,
        settings=stage_settings(stages.inertia, SimultaneousSettings()),
    )
    new = Stages(friction=new_friction, imu=stages.imu, inertia=inertia)
    if not material.known:
        return new
    return held(new, stages, fit or Model(material.ground(model), FREE))


def _sequential(material: RefinementData, model: Refitted) -> Stages:
    """Identify friction, gravity and inertia again, one after the other."""
    robot = material.robot
    stages = model.stages
    new = structs.replace(stages, effects=None)

    # Each log as it was read for its stage, and as it is freed of the effects: of one
    # that is fitted without its events.
    earlier = {identity(log): log for logs in material.earlier.values() for log in logs}
    latest = earlier | {identity(log): log for log in material.training}
    freed = cache(lambda name: material.freed(latest[name], model))

    def logs_of(stage: str) -> list[_FreedLog]:
        names = [identity(log) for log in material.logs_of(stage)]
        return [_FreedLog(log=earlier[name], freed=freed(name)) for name in names]

    friction_logs = logs_of("friction")
    gravity_logs = logs_of("gravity")
    inertia_logs = logs_of("inertia")

    if stages.friction is not None:
        new.friction = _friction(robot, friction_logs, stages.friction)
    is_changed = new.friction is not stages.friction or any(
        item.is_changed for item in gravity_logs
    )
    if stages.gravity is not None and is_changed:
        with_gravity = identify_gravity(
            [item.freed for item in gravity_logs],
            robot,
            new,
            stage_settings(stages.gravity, GravitySettings()),
        )
        new.gravity = with_gravity.gravity
        new.friction = with_gravity.friction
    if stages.inertia is not None:
        logs = [item.freed for item in inertia_logs]
        logs += [freed(identity(log)) for log in material.training]
        options = _inertia_options(
            material, stages.inertia, [item.log for item in inertia_logs]
        )
        options = replace(
            options, settings=stage_settings(stages.inertia, InertiaSettings())
        )
        with_inertia = identify_inertia(unique(logs), robot, new, options=options)
        new.inertia = with_inertia.inertia
        new.friction = with_inertia.friction
    return new


def _inertia_options(
    material: RefinementData, stage: RigidStage, logs_of_stage: Sequence[Recording]
) -> InertiaOptions:
    """Return whose motion counts when a rigid body is identified again.

    Of the stage's own logs it is what the user asked for then. Where that was left to
    the stage, and of the other logs, it is what effects are looked for by.
    """
    options = material.options.motion
    recipe = recipe_of(stage)
    source_by_log = {}
    if recipe.source != "auto":
        source_by_log = {log.sha256: recipe.source for log in logs_of_stage}
    return replace(options, source_by_log=source_by_log)


@dataclass(frozen=True)
class _FreedLog:
    """A log of an earlier stage, and the same without effects and events."""

    log: Recording
    freed: Recording

    @property
    def changed_joints(self) -> Mask:
        """Joints (n,) whose torque or position the effects have changed."""
        return changed_joints(self.log, self.freed)

    @property
    def is_changed(self) -> bool:
        """Whether any joint has changed, or other samples count."""
        same_samples = np.array_equal(self.log.valid, self.freed.valid)
        return bool(self.changed_joints.any()) or not same_samples


def _friction(
    robot: Robot, logs: Sequence[_FreedLog], old: FrictionStage
) -> FrictionStage:
    """Identify friction again, of the joints that the effects change in its logs."""
    changed = np.any([item.changed_joints for item in logs], axis=0)
    travel = np.array([np.ptp(item.freed.q, axis=0) for item in logs])
    moves = travel > MOVES * travel.max(axis=0)
    if not np.any(moves & changed):
        return old

    # With all logs of every joint that moves in them: orders that the user has fixed
    # need as many speeds as there were.
    together = changed
    used = np.any(moves & together, axis=1)
    while np.any(moves[used] & ~together):
        together = together | np.any(moves[used], axis=0)
        used = np.any(moves & together, axis=1)
    logs_of_changed = [
        item.freed for item, is_used in zip(logs, used, strict=True) if is_used
    ]

    names = {
        name
        for name, is_changed in zip(robot.joint_names, changed, strict=True)
        if is_changed
    }
    new = identify_friction(
        logs_of_changed,
        robot,
        options=friction_options(old),
        settings=stage_settings(old, FrictionSettings()),
    )
    new_joints = {name: joint for name, joint in new.joints.items() if name in names}
    return structs.replace(
        old,  # joints in the file's order
        joints=old.joints | new_joints,
        verdicts=[
            *(verdict for verdict in old.verdicts if verdict.joint not in names),
            *(verdict for verdict in new.verdicts if verdict.joint in names),
        ],
        notes=list(dict.fromkeys([*old.notes, *new.notes])),
    )


# ---- stages that move a little


def held(new: Stages, old: Stages, fit: Model) -> Stages:
    """Return new simultaneous stages without what moved by less than its error.

    Directions that these logs leave loose would wander with every effect that is added.

    Parameters
    ----------
    new : Stages
        The stages identified anew.
    old : Stages
        Those before.
    fit : Model
        Of the same logs.
    """
    old_values = _values(old, fit)
    new_values = _values(new, fit)
    at = np.flatnonzero((new_values.std_errors > 0.0) & (old_values.std_errors > 0.0))
    if not len(at):
        return new

    # The fit's covariance has the correlations, the stages have the size.
    covariance = fit.linear.covariance[np.ix_(at, at)].copy()
    variance_ratio = new_values.std_errors[at] ** 2 / np.diag(covariance)
    covariance *= float(np.median(variance_ratio))
    scale = np.sqrt(np.diag(covariance))
    variance, direction = np.linalg.eigh(covariance / np.outer(scale, scale))

    change = direction.T @ ((new_values.values - old_values.values)[at] / scale)
    is_unclear = change**2 < CLEAR**2 * variance
    is_loose = variance > LOOSE
    undone = np.where(is_unclear & is_loose, change, 0.0)
    theta = np.zeros(fit.linear.size)
    theta[at] = -scale * (direction @ undone)
    return moved(new, fit, theta)


class _Values(NamedTuple):
    """Values and standard errors (p,) of stages, as the base's columns are ordered."""

    values: Array
    std_errors: Array


def _values(stages: Stages, fit: Model) -> _Values:
    """Return values and standard errors of simultaneous stages; zero where unknown."""
    names = fit.ground.stage.scenes[0].robot.joint_names
    where = fit.linear.where
    size = where[len(names)].stop
    values = np.zeros(size)
    std_errors = np.zeros(size)

    rigid = {}
    if stages.inertia is not None:
        rigid = {parameter.name: parameter for parameter in stages.inertia.parameters}
    for number, name in enumerate(fit.ground.base.basis.names):
        if name in rigid:
            values[number] = rigid[name].value
            std_errors[number] = rigid[name].uncertainty

    for name, at in zip(names, where[1:], strict=False):
        joint = stages.friction.joints.get(name) if stages.friction else None
        if joint is not None and joint.parameters:
            values[at] = [parameter.value for parameter in joint.parameters]
            std_errors[at] = [parameter.uncertainty for parameter in joint.parameters]
    return _Values(values=values, std_errors=std_errors)


def moved(stages: Stages, fit: Model, theta: Array) -> Stages:
    """Return the stages with deviations of the base added to what they say.

    Parameters
    ----------
    stages : Stages
        What the deviations are from.
    fit : Model
        It says how the base's parameters are ordered.
    theta : (p,) array
        The deviations.
    """
    robot = fit.ground.stage.scenes[0].robot
    basis = fit.ground.base.basis
    where = fit.linear.where
    rigid_change = theta[where[0]]
    result = Stages(imu=stages.imu)

    if stages.friction is not None:
        joints = dict(stages.friction.joints)
        for name, at in zip(robot.joint_names, where[1:], strict=False):
            if name in joints:
                joints[name] = _moved_friction(joints[name], theta[at])
        result.friction = structs.replace(stages.friction, joints=joints)

    change_of = dict(zip(basis.names, rigid_change, strict=True))
    result.gravity = _moved_rigid(stages.gravity, change_of)
    result.inertia = _moved_rigid(stages.inertia, change_of)

    # The last stage has parameters of links that stand for all of them.
    last = result.inertia or result.gravity
    if last is not None:
        added = representative_of(basis, rigid_change, np.zeros(robot.n))
        representative = {}
        for name in standard_names(robot.n):
            value = last.representative.get(name, 0.0) + added.get(name, 0.0)
            if value != 0.0:
                representative[name] = float(value)
        last.representative = representative
    return result


def _moved_rigid(
    stage: RigidStage | None, change_of: Mapping[str, float]
) -> RigidStage | None:
    """Return a stage whose parameters moved."""
    if stage is None:
        return None
    parameters = [
        structs.replace(
            parameter,
            value=float(parameter.value + change_of.get(parameter.name, 0.0)),
        )
        for parameter in stage.parameters
    ]
    return structs.replace(
        stage, parameters=parameters, representative=dict(stage.representative)
    )


def _moved_friction(joint: FrictionJoint, change: Array) -> FrictionJoint:
    """Return a surface whose entries moved, with the parameters of a one-step fit."""
    positive = np.array(joint.positive)
    negative = np.array(joint.negative)
    size = positive.size
    parameters = joint.parameters
    if parameters:
        of_ahead, of_back = surface_entries(joint.speed_range[1], len(change))
        ahead = of_ahead @ change
        back = of_back @ change
        parameters = [
            structs.replace(parameter, value=float(parameter.value + by))
            for parameter, by in zip(parameters, change, strict=True)
        ]
    else:
        ahead = change[:size]
        back = change[size : 2 * size] if joint.directional else ahead
    return structs.replace(
        joint,
        positive=(positive + ahead.reshape(positive.shape)).tolist(),
        negative=(negative + back.reshape(negative.shape)).tolist(),
        parameters=parameters,
    )
