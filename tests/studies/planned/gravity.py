"""Planned gravity: predicted errors against stated ones, and Eq. 20 against a long
search.
"""

from argparse import Namespace
from dataclasses import dataclass

import numpy as np
from scipy.optimize import Bounds, minimize

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.friction_surface.trials import collect_trials
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.plan.belief import belief_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.gravity import plan_gravity
from seqid_cli.robot.base_parameters import base_parameters, gravity_base_regressor
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index
from tests.plants.arms.rigs import six_joint
from tests.plants.motions.experiments import friction_trials
from tests.plants.planned import recorded
from tests.plants.robots.lab import run
from tests.plants.samples import SIX_POSTURES
from tests.studies.rigs.repetition import another
from tests.studies.tables import number, share_within, table

SEED, ARMS, DRAWS = 78, 2, 2
EVERY = 4  # control periods per row: 250 Hz
OPTIONS = PlanOptions(ramp_s=0.2, floor=False)


@dataclass(frozen=True)
class Obtained:
    """What following a plan gave.

    `ratios` (p,) are stated standard errors, RMS over the draws, over the predicted
    ones; `lost` is the share of steady slices that lie outside the friction that was
    given.
    """

    ratios: Array
    lost: float


def study(chosen: Namespace) -> str:
    """Tables of predicted errors, and of conditions."""
    rows = []
    for arm in range(ARMS):
        found = followed(arm, DRAWS)
        numbers = [number(x, 3) for x in np.percentile(found.ratios, [50, 0, 100])]
        share = f"{share_within(found.ratios - 1.0, 0.25):.0%}".replace("%", " %")
        lost = f"{found.lost:.1%}".replace("%", " %")
        rows.append([str(arm + 1), str(len(found.ratios)), lost, share, *numbers])
    head = [
        "arm",
        "parameters",
        "outside friction",
        "within 25 %",
        "median",
        "least",
        "largest",
    ]
    return table(head, rows)


def followed(arm: int, draws: int) -> Obtained:
    """Record what a gravity plan for a friction file asks for, and identify gravity
    with it.
    """
    plant = another(six_joint(), np.random.default_rng([SEED, arm]))
    trials = friction_trials(plant, SIX_POSTURES[0], lowest=0.08)
    experiment = run("six_joint", plant, trials, arm, every=EVERY)
    robot = experiment.robot
    surface = identify_friction(
        experiment.recordings["friction"], robot, options=FrictionOptions()
    )
    stages = Stages(friction=surface)
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=OPTIONS.ramp_s))
    planned = plan_gravity(belief, stages, OPTIONS).gravity
    obtained, lost = [], 0.0
    for draw in range(draws):
        logs = recorded(plant, planned.moves, 8000 + 97 * arm + draw, every=EVERY)
        obtained.append(identify_gravity(logs, robot, stages))
        lost = max(lost, share_outside(logs, robot, stages))
    predicted = {p.name: p.std_error for p in planned.stage.parameters}
    return Obtained(ratios=ratios(predicted, obtained), lost=lost)


def ratios(predicted: dict[str, float], obtained: list[RigidStage]) -> Array:
    """Return stated errors, RMS over the draws, over predicted ones."""
    squares = [{p.name: p.std_error**2 for p in stage.parameters} for stage in obtained]
    names = [name for name in predicted if all(name in own for own in squares)]
    return np.array(
        [
            np.sqrt(np.mean([own[name] for own in squares])) / predicted[name]
            for name in names
        ]
    )


def share_outside(logs: list[Recording], robot: Robot, stages: Stages) -> float:
    """Return the share of the steady slices of logs where friction was not
    identified.
    """
    surfaces = friction_surfaces(stages, robot)
    outside, total = 0, 0
    for trial in collect_trials(logs, robot):
        surface = surfaces[trial.joint]
        total += len(trial.q)
        speed = np.full(len(trial.q), trial.velocity)
        known = surface is not None and ~surface.outside(trial.q, speed)
        outside += len(trial.q) - int(np.sum(known))
    return outside / max(total, 1)


@dataclass(frozen=True, kw_only=True)
class LongSearch:
    """A search for the least condition of Phi(H_g) that shares nothing with the plan's
    own.

    Parameters
    ----------
    robot : Robot
    joints : (M,) int
        The joint that each sweep moves.
    ends : (M, 2) float
        Where its steady way begins and ends [rad].
    speed : (M,) float
        Its speed [rad/s].
    lower, upper : (n,) float
        Where joints may be locked [rad].
    """

    robot: Robot
    joints: Index
    ends: Array
    speed: Array
    lower: Array
    upper: Array

    def least(self, *, scaled: bool, starts: int, seed: int, drawn: int = 100) -> float:
        """Return the least condition that descents from the best of random sets
        find.
        """
        rng = np.random.default_rng(seed)
        found = []
        for _ in range(starts):
            sets = rng.uniform(size=(drawn, len(self.joints), self.robot.n))
            values = [_condition(self.normal(x).sum(axis=0), scaled) for x in sets]
            found.append(self._descent(sets[int(np.argmin(values))], scaled))
        return min(found)

    def normal(self, x: Array, *, points: int = 9) -> Array:
        """Return Phi' Phi (M, g, g) of sweeps with joints locked at shares x (M, n) of
        ranges.
        """
        every = np.arange(len(self.joints))
        locked = self.lower + x * (self.upper - self.lower)
        q = np.repeat(locked[:, None], points, axis=1)
        places = np.linspace(self.ends[:, 0], self.ends[:, 1], points, axis=1)
        q[every, :, self.joints] = places

        basis = base_parameters(self.robot, rotor=())
        H = gravity_base_regressor(self.robot, basis, q.reshape(-1, self.robot.n))
        rows = H.reshape(len(every), points, self.robot.n, -1)[every, :, self.joints]
        seconds = np.diff(self.ends)[:, 0] / self.speed
        return np.asarray(np.einsum("mpa,mpb,m->mab", rows, rows, seconds / points))

    def _descent(self, start: Array, scaled: bool) -> float:
        """Return the condition at the end of a descent in all postures at once."""
        shape = start.shape

        def value(flat: Array) -> tuple[float, Array]:
            x = flat.reshape(shape)
            each = self.normal(x)
            total = each.sum(axis=0)
            here = np.log(_condition(total, scaled))
            gradient = np.empty(shape)
            for k in range(shape[1]):
                step = np.where(x[:, k] > 0.5, -1e-4, 1e-4)
                moved = x.copy()
                moved[:, k] += step
                changed = total + self.normal(moved) - each
                gradient[:, k] = (np.log(_condition(changed, scaled)) - here) / step
            return float(here), gradient.ravel()

        found = minimize(
            value,
            np.array(start.ravel()),
            jac=True,
            method="L-BFGS-B",
            bounds=Bounds(np.zeros(start.size), np.ones(start.size)),
            options={"maxiter": 150},
        )
        return float(np.exp(found.fun))


def _condition(normal: Array, scaled: bool) -> Array:
    """Return the condition (...) of Phi by Phi' Phi (..., g, g), columns of length 1 if
    scaled.
    """
    if scaled:
        size = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
        normal = normal / (size[..., :, None] * size[..., None, :])
    values = np.linalg.eigvalsh(normal)
    least = np.maximum(values[..., 0], 1e-12 * values[..., -1])
    return np.asarray(np.sqrt(values[..., -1] / least))
