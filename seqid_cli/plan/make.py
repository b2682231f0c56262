"""From a robot file and earlier results to a plan file: all plans are made here."""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import structs

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.planned import sampled
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, robot_id, used_settings
from seqid_cli.params.results.plan import (
    PLAN_SCHEMA,
    EffectSeparation,
    JointLimits,
    PlanFile,
    PlannedMove,
)
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import Stages, Verdict
from seqid_cli.plan.belief import Belief, belief_of, information_of
from seqid_cli.plan.discrimination.discriminate import plan_discriminate
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.floor import Floor
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.settings import DiscriminationSettings, PlanSettings
from seqid_cli.plan.stages.drive import plan_drive
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.plan.stages.gravity import plan_gravity
from seqid_cli.plan.stages.inertia import plan_inertia, plan_validation
from seqid_cli.plan.stages.payload import loaded, plan_payload
from seqid_cli.plan.stages.sweeps import plan_friction, plan_imu
from seqid_cli.plan.ways import note_on_ways
from seqid_cli.robot.types import Robot
from seqid_cli.robot.urdf_model import Geometry
from seqid_cli.shares import percent
from seqid_cli.typing import Array

# Stages in the order of the work, which is that of the plan file.
_STAGES = (
    "friction",
    "gravity",
    "imu-calib",
    "inertia",
    "payload",
    "drive",
    "validation",
)
# What is planned by itself alone.
_ALONE = ("payload", "drive")


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
    settings: PlanSettings = PlanSettings(),
) -> PlanFile:
    """Plan one stage, or all in the order of the work.

    Parameters
    ----------
    what : str
        One of `seqid_cli.plan.options.What`.
    robot : Robot
    limits : Limits
    stages : Stages
        What is identified already.
    options : PlanOptions
    parameters : sequence of FileId
        The files that `stages` come from.
    have : iterable of Recording
        Logs that are there already: moves are to show what these do not.
    geometry : Geometry, optional
    floor : Floor, optional
    settings : PlanSettings
        Numbers that decide.

    Returns
    -------
    PlanFile
    """
    belief = belief_of(
        robot,
        stages,
        limits,
        geometry=geometry,
        floor=floor,
        margins=settings.margins,
    )
    if what == "discriminate":
        planned = {
            what: plan_discriminate(
                belief, stages, options, list(have), settings.discrimination
            )
        }
    else:
        planned = _plan_stages(what, belief, stages, options, have)

    moves: list[PlannedMove] = []
    for name, of_stage in planned.items():
        of_stage.stage.duration_s = sum(move.duration_s for move in of_stage.moves)
        moves += [structs.replace(move, stage=name) for move in of_stage.moves]
    if belief.theta is not None:
        moves = _with_torques(belief, moves, options)

    names = robot.joint_names
    noise = np.sqrt(2.0 / belief.information_rate)
    duration_s = sum(move.duration_s for move in moves)
    verdicts = []
    for name, of_stage in planned.items():
        verdicts += _verdicts(name, of_stage, settings.discrimination)
    return PlanFile(
        **head(PLAN_SCHEMA, now()),
        robot=robot_id(robot),
        what=what,
        seed=options.seed,
        parameters=list(parameters),
        limits={name: _limits_entry(limits, j) for j, name in enumerate(names)},
        noise_density={name: float(noise[j]) for j, name in enumerate(names)},
        noise_origin=belief.noise_origin,
        moves=moves,
        stages={name: of_stage.stage for name, of_stage in planned.items()},
        duration_s=duration_s,
        total_s=duration_s + _time_between(moves, limits, names),
        speed_scale=options.speed_scale,
        verdicts=verdicts,
        settings=used_settings(settings),
        notes=_notes(belief, options, moves),
    )


def _limits_entry(limits: Limits, j: int) -> JointLimits:
    """Return the limits of joint j as the plan file has them."""
    torque = float(limits.torque[j]) if np.isfinite(limits.torque[j]) else None
    return JointLimits(
        position=[float(limits.lower[j]), float(limits.upper[j])],
        speed=float(limits.speed[j]),
        acceleration=float(limits.acceleration[j]),
        torque=torque,
        moves=bool(limits.moves[j]),
    )


def _plan_stages(
    plan_name: str,
    belief: Belief,
    stages: Stages,
    options: PlanOptions,
    have: Iterable[Recording],
) -> dict[str, Planned]:
    """Plan one stage, or all one after the other.

    Each is planned on the information of the logs and of the moves of stages before it.
    """
    names = [plan_name]
    if plan_name == "all":
        names = [name for name in _STAGES if name not in _ALONE]
        if not belief.robot.imus:
            names.remove("imu-calib")

    information = information_of(belief, have)
    planned: dict[str, Planned] = {}
    for name in names:
        if name == "gravity":
            # Friction that gravity lacks is planned as well, before it.
            plan = plan_gravity(belief, stages, options, planned.get("friction"))
            if plan.friction is not None:
                planned.setdefault("friction", plan.friction)
            planned[name] = plan.gravity
        else:
            planned[name] = _plan_stage(name, belief, stages, options, information)
        added = planned[name].information
        if added is not None:
            information = information + added
    return {name: planned[name] for name in _STAGES if name in planned}


def _plan_stage(
    name: str,
    belief: Belief,
    stages: Stages,
    options: PlanOptions,
    information: Array,
) -> Planned:
    """Plan a stage other than gravity; `information` (b, b) is there already."""
    if name == "friction":
        return plan_friction(belief, options)
    if name == "imu-calib":
        return plan_imu(belief, options)
    if name == "inertia":
        return plan_inertia(belief, stages, options, information)
    if name == "payload":
        return plan_payload(belief, stages, options)
    if name == "drive":
        return plan_drive(belief, options)
    if name == "validation":
        return plan_validation(belief, options)
    raise KeyError(name)


def _with_torques(
    belief: Belief, moves: Sequence[PlannedMove], options: PlanOptions
) -> list[PlannedMove]:
    """Return the moves with the torque that is expected along each."""
    with_payload = loaded(belief, options.load_kg)
    return [
        _with_torque(with_payload if move.stage == "payload" else belief, move)
        for move in moves
    ]


def _with_torque(
    belief: Belief, move: PlannedMove, *, rate_hz: float = 50.0, points: int = 40
) -> PlannedMove:
    """Return a move with its expected torque: the largest of each of `points` parts."""
    names = belief.robot.joint_names
    t, q, dq, ddq = sampled(move, names, rate_hz)
    states = Moves(t, q[None], dq[None], ddq[None])
    torque = belief.torque(states, belief.regressor(states))[0]

    parts = [part.max(axis=0) for part in np.array_split(torque, points)]
    largest = {}
    for j, name in enumerate(names):
        # Four digits: the file is for people, too.
        largest[name] = [float(f"{part[j]:.4g}") for part in parts]

    torque_share = None
    if np.isfinite(belief.limits.torque).any():
        torque_share = float((torque / belief.limits.torque).max())
    return structs.replace(move, torque=largest, torque_share=torque_share)


def _time_between(
    moves: Sequence[PlannedMove], limits: Limits, names: Sequence[str]
) -> float:
    """Return the time [s] from the ends of moves to the next starts.

    Joints go there at half their largest speed; the slowest one counts.
    """
    speed = limits.speed / 2
    ramp_s = np.divide(limits.speed, 2 * limits.acceleration)
    total_s = 0.0
    for previous, following in itertools.pairwise(moves):
        distance = np.array(
            [abs(following.start[name] - previous.start[name]) for name in names]
        )
        total_s += float(np.max((distance / speed + ramp_s)[limits.moves]))
    return total_s


def _verdicts(
    stage_name: str, planned: Planned, settings: DiscriminationSettings
) -> list[Verdict]:
    """Return whether moves will determine all that their stage is about."""
    stage = planned.stage
    if stage.separation is not None:
        return [_separation_verdict(stage.separation, settings.min_power)]
    if stage_name == "discriminate":
        return [Verdict(good=False, reason=stage.notes[0])]
    if stage.rank is None:
        return []
    reason = f"{stage_name}: rank {stage.rank} of {stage.structural_rank}"
    return [Verdict(good=stage.rank == stage.structural_rank, reason=reason)]


def _separation_verdict(separation: EffectSeparation, min_power: float) -> Verdict:
    """Return whether a diagnosis after these moves will tell two effects apart."""
    outcomes = zip(
        separation.between,
        reversed(separation.between),
        separation.powers,
        separation.imitations,
        strict=True,
    )
    sentences = []
    for true_effect, rival, power, imitated in outcomes:
        sentences.append(
            f"if it is {true_effect}, the diagnosis drops {rival} with probability"
            f" {percent(power, 0)} ({rival} reaches up to {percent(imitated)} of the"
            " gain)"
        )
    return Verdict(good=separation.power >= min_power, reason="; ".join(sentences))


def _notes(
    belief: Belief, options: PlanOptions, moves: Sequence[PlannedMove]
) -> list[str]:
    """Say what was assumed of limits, floor and shapes, and what was not checked."""
    robot = belief.robot
    limits = belief.limits
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
    notes.append(note_on_ways(belief, moves))

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
