"""Planned moves against random sets and a peer's optimiser."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, belief_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.moves.fourier import COARSE_HZ, Moves, Shapes
from seqid_cli.plan.moves.trajectories import sampled
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.choose import Goal, Pool, draw_pool, groups_of
from seqid_cli.plan.stages.inertia import plan_inertia
from seqid_cli.plan.stages.predicted_errors import rank_and_condition
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Array, Robot
from tests.studies.tables import number, table

PEERS = ("ur10", "panda")
MOVE_S = 8.0  # four intervals of the peer's default
SETS = 1000
RATE_HZ = 25.0  # on which motions are judged
SEED = 1  # of the random sets: another than the plan's


@dataclass(frozen=True)
class Yardstick:
    """What motions of an arm are judged by; all of them alike."""

    belief: Belief
    goal: Goal

    @classmethod
    def of(cls, robot: Robot) -> Yardstick:
        """With nothing known but the URDF."""
        belief = belief_of(robot, Stages(), limits_of(robot, ramp_s=PlanOptions.ramp_s))
        return cls(belief, Goal.of(belief, PlanOptions.seed))

    def information(self, moves: Moves) -> Array:
        """Scaled information (b, b) of all moves together."""
        own = self.belief.information(moves, self.belief.regressor(moves))
        return self.goal.scaled(own.sum(axis=0))

    def judged(self, information: Array) -> Array:
        """Condition, torque error over noise, then every standard error (2 + b,)."""
        return self.all_judged(information[None])[0]

    def all_judged(self, information: Array) -> Array:
        """The same of many sets (S, b, b): (S, 2 + b); infinite where the rank is not full."""
        found = np.full((len(information), 2 + information.shape[1]), np.inf)
        for k, one in enumerate(information):
            rank, condition = rank_and_condition(one)
            if rank == len(one):
                errors = np.sqrt(np.diag(self.goal.covariance(one)))
                size = np.sqrt(self.goal.errors(one) / len(self.goal.shared))
                found[k] = [condition, size, *errors]
        return found

    def pool(self, *, together: bool, size: int, seed: int) -> Pool:
        """Moves drawn within the limits."""
        shapes, rng = Shapes.over(MOVE_S, COARSE_HZ), np.random.default_rng(seed)
        groups = groups_of(self.belief.limits, together=together)
        return draw_pool(self.belief, self.goal, shapes, groups, size, rng)


def study(chosen: Namespace) -> str:
    """All tables; those of the peers' arms where their motions are in the cache."""
    folder = chosen.cache / "peers"
    arms = {name: folder / f"{name}.npz" for name in PEERS}
    missing = [str(path) for path in arms.values() if not path.is_file()]
    if missing:
        raise SystemExit(f"{', '.join(missing)} missing: run make study-plan")
    parts = [against_all(name, path) for name, path in arms.items()]
    return "\n\n".join(parts)


def against_all(name: str, path: Path) -> str:
    """Planned, random and the peer's motions of one arm, within the same limits and time."""
    with np.load(path) as data:
        stick = Yardstick.of(peer_robot(name, str(data["urdf"]), data["joints"].tolist()))
        t = np.arange(data["q"].shape[1]) / float(data["rate"])
        own = Moves(t, data["q"], data["dq"], data["ddq"])
        count = len(own.q)
        peer, cpu = stick.judged(stick.information(own)), float(data["cpu"])
    rows, plans = [], {}
    for together in (False, True):
        label = "all at once" if together else "two at a time"
        plans[label], seconds, rank = planned(stick, count, together=together)
        rows.append((f"planned, {label}, rank {rank}", plans[label], f"{seconds:.1f}"))
        chance = stick.all_judged(random_sets(stick, count, together=together))
        rows.append((f"random, {label}: median of each", np.median(chance, axis=0), ""))
        rows.append((f"random, {label}: best of each", chance.min(axis=0), ""))
    limits = replace(stick.belief.limits, acceleration=np.abs(own.ddq).max(axis=(0, 1)))
    held = replace(stick, belief=replace(stick.belief, limits=limits))
    found, seconds, _ = planned(held, count, together=True)
    rows.append(("planned, with the peaks of FIGAROH's acceleration", found, f"{seconds:.1f}"))
    rows.append(("FIGAROH, all at once", peer, f"{cpu:.0f}"))
    best = plans["all at once"]
    cells = [
        [
            label,
            number(found[0], 3),
            number(found[1]),
            number(float(np.median(found[2:] / best[2:]))),
            number(float(np.max(found[2:] / best[2:]))),
            seconds,
        ]
        for label, found, seconds in rows
    ]
    head = ["set of moves", "condition", "torque error over noise", "errors: median", "worst"]
    heading = f"{name}, {count * MOVE_S:.0f} s, {len(peer) - 2} parameters:"
    return f"{heading}\n\n{table([*head, 'CPU s'], cells)}"


def peer_robot(name: str, urdf: str, joints: Sequence[str]) -> Robot:
    """The arm of a URDF's text, some joints of which are the robot's."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "arm.urdf").write_text(urdf, encoding="utf-8")
        path = Path(folder) / "robot.toml"
        head = f'schema = "seqid/robot@1"\nname = "{name}"\nurdf = "arm.urdf"\n'
        entries = "".join(f'\n[[joint]]\nname = "{joint}"\n' for joint in joints)
        path.write_text(f"{head}gravity = [0.0, 0.0, -9.81]\n{entries}", encoding="utf-8")
        return load_robot(path)


def planned(stick: Yardstick, count: int, *, together: bool) -> tuple[Array, float, str]:
    """A plan as it is judged, the CPU time in s that it took, and its rank."""
    options = PlanOptions(duration_s=count * MOVE_S, move_s=MOVE_S, together=together)
    start = time.process_time()
    made = plan_inertia(stick.belief, Stages(), options)
    seconds = time.process_time() - start
    states = [sampled(move, stick.belief.robot.joint_names, RATE_HZ) for move in made.moves]
    moves = Moves(states[0][0], *(np.array([s[k] for s in states]) for k in (1, 2, 3)))
    rank = f"{made.stage.rank} of {made.stage.structural_rank}"
    return stick.judged(stick.information(moves)), seconds, rank


def random_sets(stick: Yardstick, count: int, *, together: bool) -> Array:
    """Information (S, b, b) of random sets as long as the plan, of moves that are drawn once."""
    pool = stick.pool(together=together, size=PlanOptions.pool, seed=SEED)
    rng = np.random.default_rng(SEED)
    sets = [rng.choice(len(pool.joints), count, replace=False) for _ in range(SETS)]
    return np.array([pool.information[s].sum(axis=0) for s in sets])
