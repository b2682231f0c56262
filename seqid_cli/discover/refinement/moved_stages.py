"""Stages moved by deviations of the base, and held where logs hardly tell them."""

import numpy as np
from msgspec.structs import replace

from seqid_cli.discover.select.model import Model
from seqid_cli.identify.rigid.parameters import representative_of
from seqid_cli.identify.rigid.simultaneous import surface_entries
from seqid_cli.params.schema import FrictionJoint, RigidStage, Stages
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.typing import Array

LOOSE = 3.0  # variance of a direction over that of its parameters, from which it may be held
CLEAR = 2.0  # standard errors, that such a direction must move by to leave the file


def held(new: Stages, old: Stages, fit: Model) -> Stages:
    """Simultaneous stages without what moved by less than its error, where logs hardly tell it.

    Directions that these logs leave loose would wander with every effect that is added. `fit` is of
    the same logs, and `old` are the stages before.
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
    result, basis, change = Stages(imu=stages.imu), fit.ground.base.basis, theta[where[0]]
    if stages.friction is not None:
        joints = dict(stages.friction.joints)
        for name, own in zip(robot.joint_names, where[1:], strict=False):
            if name in joints:
                joints[name] = _moved_friction(joints[name], theta[own])
        result.friction = replace(stages.friction, joints=joints)
    more = dict(zip(basis.names, change, strict=True))

    def moved_rigid(stage: RigidStage | None) -> RigidStage | None:
        if stage is None:
            return None
        own = [replace(p, value=float(p.value + more.get(p.name, 0.0))) for p in stage.parameters]
        return replace(stage, parameters=own, representative=dict(stage.representative))

    result.gravity, result.inertia = moved_rigid(stages.gravity), moved_rigid(stages.inertia)
    last = result.inertia or result.gravity
    if last is not None:
        now, added = last.representative, representative_of(basis, change, np.zeros(robot.n))
        total = {x: now.get(x, 0.0) + added.get(x, 0.0) for x in standard_names(robot.n)}
        last.representative = {x: float(v) for x, v in total.items() if v != 0.0}
    return result


def _moved_friction(joint: FrictionJoint, change: Array) -> FrictionJoint:
    """A surface whose entries moved; of a simultaneous fit the parameters as well."""
    positive, negative = np.array(joint.positive), np.array(joint.negative)
    size, parameters = positive.size, joint.parameters
    if parameters:
        ahead, back = (own @ change for own in surface_entries(joint.speed_range[1], len(change)))
        pairs = zip(parameters, change, strict=True)
        parameters = [replace(p, value=float(p.value + c)) for p, c in pairs]
    else:
        ahead, back = change[:size], change[size : 2 * size] if joint.directional else change[:size]
    return replace(
        joint,
        positive=(positive + ahead.reshape(positive.shape)).tolist(),
        negative=(negative + back.reshape(negative.shape)).tolist(),
        parameters=parameters,
    )
