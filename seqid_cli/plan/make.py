"""From a robot file and earlier results to a plan file: all plans are made here."""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import structs

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.planned import sampled
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.results.plan import (
    PLAN_SCHEMA,
    JointLimits,
    PlanFile,
    PlannedMove,
)
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import Stages, Verdict
from seqid_cli.plan.belief import Belief, belief_of, information_of
from seqid_cli.plan.discrimination.discriminate import ENOUGH, plan_discriminate
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.floor import Floor
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.plan.stages.gravity import plan_gravity
from seqid_cli.plan.stages.inertia import plan_inertia, plan_validation
from seqid_cli.plan.stages.payload import loaded, plan_payload
from seqid_cli.plan.stages.sweeps import plan_friction, plan_imu
from seqid_cli.robot.types import Robot
from seqid_cli.robot.urdf_model import Geometry
from seqid_cli.shares import percent


def make_plan(
    what: str,
    robot: Robot,
    limits: Limits,
    stages: Stages,
    options: PlanOptions,
    parameters: Sequence[FileId] = (),
    have: Iterable[Recording] = (),
    geometry: Geometry | None = None,
    floor: Floor | None = None,
) -> PlanFile:
    """Plan one stage, or all in the order of the work: what the logs `have` do not tell."""
    belief = belief_of(robot, stages, limits, geometry=geometry, floor=floor)
    if what == "discriminate":
        found = {what: plan_discriminate(belief, stages, options, list(have))}
    else:
        found = _session(what, belief, stages, options, have)
    moves: list[PlannedMove] = []
    for name, planned in found.items():
        planned.stage.duration_s = sum(move.duration_s for move in planned.moves)
        moves += [structs.replace(move, stage=name) for move in planned.moves]
    if belief.theta is not None:
        heavy = loaded(belief, options.load_kg)
        moves = [
            _with_torque(heavy if m.stage == "payload" else belief, m) for m in moves
        ]
    names = robot.joint_names
    noise = np.sqrt(2.0 / belief.density)
    durations = [move.duration_s for move in moves]
    return PlanFile(
        **head(PLAN_SCHEMA, now()),
        robot=robot_id(robot),
        what=what,
        seed=options.seed,
        parameters=list(parameters),
        limits={
            name: JointLimits(
                position=[float(limits.lower[j]), float(limits.upper[j])],
                speed=float(limits.speed[j]),
                acceleration=float(limits.acceleration[j]),
                torque=(
                    float(limits.torque[j]) if np.isfinite(limits.torque[j]) else None
                ),
                moves=bool(limits.moves[j]),
            )
            for j, name in enumerate(names)
        },
        noise_density={name: float(noise[j]) for j, name in enumerate(names)},
        noise_origin=belief.noise_origin,
        moves=moves,
        stages={name: planned.stage for name, planned in found.items()},
        duration_s=sum(durations),
        total_s=sum(durations) + _ways(moves, limits, names),
        speed_scale=options.speed_scale,
        verdicts=[
            v for name, planned in found.items() for v in _verdicts(name, planned)
        ],
        notes=_notes(belief, options),
    )


def _session(
    what: str,
    belief: Belief,
    stages: Stages,
    options: PlanOptions,
    have: Iterable[Recording],
) -> dict[str, Planned]:
    """Plan one stage, or all one after the other, each on what logs and moves tell by then."""
    known = information_of(belief, have)
    found: dict[str, Planned] = {}
    planners = {
        "friction": lambda: plan_friction(belief, options),
        "gravity": lambda: _gravity(belief, stages, options, found),
        "imu-calib": lambda: plan_imu(belief, options),
        "inertia": lambda: plan_inertia(belief, stages, options, known),
        "payload": lambda: plan_payload(belief, stages, options),
        "validation": lambda: plan_validation(belief, options),
    }
    names = [what]
    if what == "all":
        left_out = {"payload"} if belief.robot.imus else {"payload", "imu-calib"}
        names = [name for name in planners if name not in left_out]
    for name in names:
        found[name] = planners[name]()
        added = found[name].information
        known = known if added is None else known + added
    order = list(planners)
    return dict(sorted(found.items(), key=lambda item: order.index(item[0])))


def _gravity(
    belief: Belief, stages: Stages, options: PlanOptions, found: dict[str, Planned]
) -> Planned:
    """Plan gravity on the friction that is given or planned; friction it lacks goes to `found`."""
    planned = plan_gravity(belief, stages, options, found.get("friction"))
    if planned.friction is not None:
        found.setdefault("friction", planned.friction)
    return planned.gravity


def _with_torque(
    belief: Belief, move: PlannedMove, *, rate_hz: float = 50.0, points: int = 40
) -> PlannedMove:
    """The torque that is expected along a move: the largest of each of `points` parts of it."""
    names = belief.robot.joint_names
    t, *states = sampled(move, names, rate_hz)
    moves = Moves(t, *(x[None] for x in states))
    torque = belief.torque(moves, belief.regressor(moves))[0]
    parts = np.array([part.max(axis=0) for part in np.array_split(torque, points)])
    limited = np.isfinite(belief.limits.torque).any()
    share = float((torque / belief.limits.torque).max()) if limited else None
    shown = {
        name: [float(f"{x:.4g}") for x in parts[:, j]] for j, name in enumerate(names)
    }
    return structs.replace(move, torque=shown, torque_share=share)


def _ways(moves: Sequence[PlannedMove], limits: Limits, names: Sequence[str]) -> float:
    """Time in s from the end of each move to the start of the next, at half the largest speed."""
    total = 0.0
    for before, after in itertools.pairwise(moves):
        gaps = np.array([abs(after.start[name] - before.start[name]) for name in names])
        speed, ramp = limits.speed / 2, np.divide(limits.speed, 2 * limits.acceleration)
        total += float(np.max((gaps / speed + ramp)[limits.moves]))
    return total


def _verdicts(what: str, planned: Planned) -> list[Verdict]:
    stage, told = planned.stage, planned.stage.separation
    if told is not None:
        pairs = zip(
            told.between,
            reversed(told.between),
            told.powers,
            told.imitations,
            strict=True,
        )
        reason = "; ".join(
            f"if it is {one}, the diagnosis drops {other} with probability"
            f" {percent(power, 0)} ({other} reaches up to {percent(most)} of the gain)"
            for one, other, power, most in pairs
        )
        return [Verdict(good=told.power >= ENOUGH, reason=reason)]
    if what == "discriminate":
        return [Verdict(good=False, reason=stage.notes[0])]
    if stage.rank is None:
        return []
    reason = f"{what}: rank {stage.rank} of {stage.structural_rank}"
    return [Verdict(good=stage.rank == stage.structural_rank, reason=reason)]


def _notes(belief: Belief, options: PlanOptions) -> list[str]:
    """Say what was assumed of limits, floor and shapes, and what was not checked."""
    robot, limits = belief.robot, belief.limits
    names = np.array(robot.joint_names)
    notes = [
        f"limits: {percent(options.share, 0)} of the tighter of robot file and URDF;"
        f" from rest to the largest speed in {options.ramp_s:g} s or more"
    ]

    unlimited = names[limits.moves & np.isinf(limits.torque)]
    if belief.theta is None:
        notes.append(
            "no torque is known (neither -p nor a URDF with inertias): none was checked"
        )
    elif len(unlimited):
        listed = ", ".join(unlimited)
        notes.append(f"no torque limit in a URDF, none was checked: {listed}")
    if not any(belief.surfaces):
        notes.append(
            "friction is not known: it is not part of the torque that was checked"
        )

    notes.append(_floor_note(belief, options))
    if belief.geometry is None:
        notes.append(
            "no collision shapes in a URDF: watch the first run for collisions"
        )
    else:
        notes.append(
            "links keep 2 cm from each other and from boxes, meshes by convex hulls"
        )
    notes.append("the ways between moves are not checked")

    still = names[~limits.moves]
    if len(still):
        notes.append(f"kept still: {', '.join(still)}")
    return notes


def _floor_note(belief: Belief, options: PlanOptions) -> str:
    """Say what was assumed of the floor."""
    if belief.floor is not None:
        return belief.floor.note
    if not options.floor:
        return (
            "floor: none (--no-floor); points of the arm may come below the base plane"
        )
    if not belief.robot.gravity.any():
        return "floor: none, as the robot file has no gravity to say where down is"
    return "floor: no joint is known to lift any point of the arm, none was checked"
