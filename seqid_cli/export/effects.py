"""Effects of a refined file: what a format can hold is exported, the others are named."""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.model.effects.fitted import Fitted, FittedEffect, fitted_effects
from seqid_cli.model.effects.scene import Scene, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import standard_regressor
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Array, Robot

_RATE_HZ = 100.0
_INERTIAL = frozenset({"body", "transmission"})  # families in which such effects can be


@dataclass(frozen=True)
class Absorbed:
    """What effects add to the exported model.

    `parameters` (11 n,) standard parameters, rotors last; `springs` (n, 4) torque of a joint by
    powers of its position [N m, N m/rad ...]; `gaps` (n,) backlash [rad].
    """

    parameters: Array
    springs: Array
    gaps: Array
    notes: tuple[str, ...] = ()


def absorbed_effects(stages: Stages, robot: Robot, holds: frozenset[str] = frozenset()) -> Absorbed:
    """Add up the effects whose torque is that of inertial parameters, and those that are held.

    Each effect is evaluated at random states, far apart in time, and its torque is compared with
    the span of the standard regressor. A payload or a wrong rotor inertia lies in it. `holds` names
    the other effects that the format has a place for: "spring", "backlash".
    """
    effects = fitted_effects(stages, robot, unexplained=True)
    total = np.zeros((PER_LINK + 1) * robot.n)
    found = Absorbed(total, np.zeros((robot.n, 4)), np.zeros(robot.n))
    if not effects:
        return found
    scene = _random_scene(stages, robot)
    state = (scene.motion.q, scene.motion.dq, scene.motion.ddq)
    Y = standard_regressor(robot, *state, coupling=scene.model.coupling)
    W = Y.reshape(-1, Y.shape[2])
    notes = []
    for item in effects:
        if isinstance(item, FittedEffect) and item.effect.name in holds:
            c, joint = item.coefficients, item.joint
            assert joint is not None
            if item.effect.name == "backlash":
                found.gaps[joint] += c[0]
            else:
                found.springs[joint, : len(c)] += c[[1, 0, 3, 2][: len(c)]]
            notes.append(f"written as it is: {_name(item, robot)}")
            continue
        added = _as_parameters(item, scene, W)
        if added is None:
            notes.append(f"cannot be written to a model file and is left out: {_name(item, robot)}")
        else:
            total += added
            notes.append(f"added to the inertial parameters: {_name(item, robot)}")
    return replace(found, notes=tuple(notes))


def _as_parameters(
    item: Fitted, scene: Scene, W: Array, *, max_residual: float = 1e-7
) -> Array | None:
    """Standard parameters (11 n,) with the effect's torque; None where there are none."""
    if not isinstance(item, FittedEffect) or item.effect.family not in _INERTIAL:
        return None
    if not item.effect.available([scene], item.joint):
        return None
    torque = np.zeros_like(scene.motion.q)
    for j, part in item.torques(scene).items():
        torque[:, j] += part
    tau = torque.ravel()
    for count in (PER_LINK * scene.robot.n, W.shape[1]):  # links alone first, then rotors as well
        size = np.linalg.norm(W[:, :count], axis=0)
        size = np.where(size > 0.0, size, 1.0)
        scaled = W[:, :count] / size
        found = np.linalg.lstsq(scaled, tau, rcond=1e-10)[0]
        if tau.any() and np.linalg.norm(tau - scaled @ found) <= max_residual * np.linalg.norm(tau):
            return np.concatenate([found / size, np.zeros(W.shape[1] - count)])
    return None


def _random_scene(stages: Stages, robot: Robot) -> Scene:
    """Random states, as of a log that was recorded after all others."""
    rng = np.random.default_rng(0)
    samples = 4 * (PER_LINK + 1) * robot.n
    q, dq, ddq = rng.normal(size=(3, samples, robot.n))
    every = np.ones((samples, robot.n), dtype=bool)
    model = TorqueModel.from_stages(stages, robot)
    sessions = [entry.session for entry in stages.effects or [] if entry.session is not None]
    cutoff = Cutoff(0.1 * _RATE_HZ, np.zeros(robot.n), np.zeros(robot.n))
    motion = Motion(
        t=np.arange(samples) / _RATE_HZ,
        q=q,
        dq=2.0 * dq,
        ddq=5.0 * ddq,
        tau=None,
        moving=every,
        usable=every[:, 0],
        valid=every[:, 0],
        rate_hz=_RATE_HZ,
        lowpass=Lowpass(cutoff.hz, _RATE_HZ),
        cutoff=cutoff,
    )
    return Scene(
        robot=robot,
        motion=motion,
        model=model,
        sign_width=sign_widths(model, np.abs(motion.dq).max(axis=0)),
        log=max((len(session.logs) for session in sessions), default=0),
        period=1.0 / _RATE_HZ,
    )


def _name(item: Fitted, robot: Robot) -> str:
    if not isinstance(item, FittedEffect):
        return f"a smooth term of no known cause ({robot.joint_names[item.joint]})"
    where = robot.name_of(item.joint) or "all joints"
    return f"{item.effect.name} ({where})"
