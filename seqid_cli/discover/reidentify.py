"""The whole model anew, with effects in it.

An effect that was there when a stage was identified has biased it. The effects' torque is taken out
of the recordings, and every stage runs again on them by its own recipe; effects and base are
fitted together on the training logs, in turn with the stages. Where the logs of the earlier stages
are not at hand, the base moves as the joint fit on the training logs says, held by what the file
knew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Candidate, Stage
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.scenes import scenes_of, shared_starts
from seqid_cli.discover.search import Search
from seqid_cli.discover.system import System
from seqid_cli.identify.friction import identify_friction
from seqid_cli.identify.gravity import identify_gravity
from seqid_cli.identify.inertia import identify_inertia
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.rigid_stage import representative_of
from seqid_cli.identify.simultaneous import TERMS, identify_simultaneous, surface_entries
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import session_of, without_effects
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.params.schema import FrictionJoint, RigidStage, Stages
from seqid_cli.robot.base import standard_names
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

TURNS = 2  # of effects and stages


@dataclass(frozen=True)
class Refitted:
    """A model with effects: the stages without them, and the effects."""

    stages: Stages
    effects: tuple[Fitted, ...]


@dataclass(frozen=True)
class Material:
    """What a model is identified from.

    `earlier` are the logs of the earlier stages, by stage; empty where they are not at hand.
    """

    training: tuple[Recording, ...]
    earlier: Mapping[str, Sequence[Recording]]
    robot: Robot
    options: DiscoverOptions

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


def refitted(
    material: Material, stages: Stages, candidates: Sequence[Candidate], *, kept: bool
) -> Refitted:
    """Fit effects and model together.

    Parameters
    ----------
    material : Material
    stages : Stages
        The model as it stands.
    candidates : sequence of Candidate
        All effects that it is to have.
    kept : bool
        Whether the stages are right as they are: the arm has changed since, and only the effects
        are fitted.
    """
    for _ in range(1 if kept else TURNS):
        search = _fitted_search(material, stages, candidates, kept=kept)
        effects = _effects_of(material, search)
        if not kept:
            stages = _stages(material, stages, effects, search)
            candidates = [t.candidate for t in search.accepted]
    if not kept:
        effects = _effects_of(material, _fitted_search(material, stages, candidates, kept=True))
    return Refitted(stages, tuple(effects))


def _fitted_search(
    material: Material, stages: Stages, candidates: Sequence[Candidate], *, kept: bool
) -> Search:
    """Base and effects fitted to the training logs, settings searched once more."""
    scenes = scenes_of(material.training, material.robot, stages, options=material.options.motion)
    rows = rows_of(scenes)
    search = Search.begin(Stage(rows), base_of(rows, stages), kept=kept)
    for candidate in candidates:
        search.add(search.stage.try_all(search.system(), [candidate])[0])
    search.polish()
    return search


def _effects_of(material: Material, search: Search) -> list[Fitted]:
    """The accepted effects with their coefficients, and errors that autocorrelation widens."""
    system = search.system()
    covariance = system.block_covariance()
    starts, shared = shared_starts(material.training)
    session = session_of(material.training, starts, shared)
    return [
        FittedEffect(
            t.candidate.effect,
            t.candidate.joint,
            t.candidate.settings,
            system.theta[at],
            covariance[at, at],
            session,
        )
        for t, at in search.placed(system)
    ]


def _stages(
    material: Material, stages: Stages, effects: Sequence[Fitted], search: Search
) -> Stages:
    """Every stage again, on logs without the effects."""
    robot, motion = material.robot, material.options.motion
    friction, earlier = stages.friction, material.earlier
    if friction is not None and friction.method == "simultaneous":
        logs = unique([*earlier.get("friction", ()), *material.training])
        offset = any(len(j.parameters) == len(TERMS) for j in friction.joints.values())
        freed = material.freed(logs, stages, effects)
        new, inertia = identify_simultaneous(freed, robot, options=motion.motion, offset=offset)
        return Stages(friction=new, imu=stages.imu, inertia=inertia)
    needed = [s for s in ("friction", "gravity", "inertia") if getattr(stages, s) is not None]
    if all(earlier.get(name) for name in needed):
        return _sequential(material, stages, effects)
    return moved(stages, search, search.system())


def _sequential(material: Material, stages: Stages, effects: Sequence[Fitted]) -> Stages:
    robot, motion, earlier = material.robot, material.options.motion, material.earlier
    new = Stages(friction=stages.friction, gravity=stages.gravity, imu=stages.imu)
    new.inertia = stages.inertia
    if stages.friction is not None:
        freed = material.freed(earlier["friction"], stages, effects)
        options = FrictionOptions(motion=motion.motion)
        new.friction = identify_friction(freed, robot, options=options)
    if stages.gravity is not None:
        freed = material.freed(earlier["gravity"], stages, effects)
        new.gravity = identify_gravity(freed, robot, new, options=motion.motion)
    if stages.inertia is not None:
        logs = unique([*earlier["inertia"], *material.training])
        freed = material.freed(logs, stages, effects)
        new.inertia = identify_inertia(freed, robot, new, options=motion)
    return new


def unique(logs: Sequence[Recording]) -> list[Recording]:
    """Logs in their order, each once."""
    return list({(log.sha256, str(log.path)): log for log in logs}.values())


def moved(stages: Stages, search: Search, system: System) -> Stages:
    """The stages with the base's deviations added to what they say."""
    robot = search.stage.scenes[0].robot
    theta, n = system.theta, robot.n
    friction = None
    if stages.friction is not None:
        joints = dict(stages.friction.joints)
        for j, name in enumerate(robot.joint_names):
            if name in joints:
                joints[name] = _moved_friction(joints[name], theta[system.where[1 + j]])
        friction = msgspec.structs.replace(stages.friction, joints=joints)
    rigid = search.base.basis
    change = theta[system.where[0]]
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
