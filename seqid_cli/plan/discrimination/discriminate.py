"""Plan the motion that tells two effects apart, and say how sure the answer will be."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import msgspec
import numpy as np

from seqid_cli.discover.scenes import scenes_of as scenes_of_logs
from seqid_cli.effects.effect import Effect
from seqid_cli.effects.registry import catalogue_of
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.planned import REST_S, Shapes
from seqid_cli.params.results.plan import EffectSeparation, PlannedMove, PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, typical
from seqid_cli.plan.discrimination.question import Question
from seqid_cli.plan.discrimination.separation import (
    Separation,
    scenes_of,
    separation_of,
)
from seqid_cli.plan.moves.fourier import COARSE_HZ
from seqid_cli.plan.moves.strokes import (
    overloads,
    postures_of,
    reachable,
    stroke_move,
    top_speed,
)
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.settings import DiscriminationSettings, MarginSettings
from seqid_cli.plan.stages.goal import Goal, Planned
from seqid_cli.plan.stages.search import check_torque, draw_pool, within_limits
from seqid_cli.robot.types import Robot


def plan_discriminate(
    belief: Belief,
    stages: Stages,
    options: PlanOptions,
    have: Sequence[Recording] = (),
    settings: DiscriminationSettings = DiscriminationSettings(),
) -> Planned:
    """Choose moves after which a diagnosis tells two effects apart.

    Parameters
    ----------
    belief : Belief
    stages : Stages
        The model that the diagnosis will start from.
    options : PlanOptions
        Names the effects and the joint.
    have : sequence of Recording
        Logs that the diagnosis will have as well.
    settings : DiscriminationSettings
        When the effects are told apart.

    Returns
    -------
    Planned
        Without moves where no motion tells the effects apart.

    Raises
    ------
    UsageError
        The effects or the joint are not such as a motion could settle.
    ConfigError
        The model lacks what an effect needs.
    """
    effects, joint = effects_and_joint(belief.robot, options)
    pool = pool_of(belief, joint, options)
    scenes = scenes_of(belief, stages, pool)
    for effect in effects:
        if not effect.available(scenes, joint):
            hint = (
                "Give a file with friction and inertia, and a robot file with the"
                " joint's drive."
            )
            text = f"{effect.name} cannot be looked for with this model"
            raise ConfigError(text, where=str(belief.robot.source), hint=hint)

    # A dozen moves show what settings the grids have.
    few_scenes = scenes[:: max(1, len(scenes) // 12)]
    question = Question.of(belief, effects, joint, few_scenes)
    logs = []
    if have:
        logs = scenes_of_logs(have, belief.robot, stages, options=InertiaOptions())
    torque_size = options.size_share * _usual_torque(belief, joint)
    separation = separation_of(belief, question, scenes, torque_size, logs)

    # An effect that is a special case of its rival can be refuted, not shown.
    nested = [
        effect.name
        for effect, is_nested in zip(effects, separation.is_nested(), strict=True)
        if is_nested
    ]
    if len(nested) == 2:
        first, second = effects
        note = (
            f"no motion tells {first.name} from {second.name}: record"
            f" {first.separate_by}"
        )
        return Planned([], PlannedStage(notes=[note]))

    choice = _chosen(separation, pool, options.duration_s)
    described = _described(
        separation,
        choice,
        between=[effect.name for effect in effects],
        joint=belief.robot.name_of(joint),
        special_case=nested[0] if nested else None,
    )
    moves = [
        msgspec.structs.replace(pool[k], name=f"discriminate_{number:02d}")
        for number, k in enumerate(choice.moves, start=1)
    ]
    notes = [
        f"if it is {effect.name}, these moves may leave it open: record"
        f" {effect.separate_by}"
        for effect, power in zip(effects, described.powers, strict=True)
        if power < settings.min_power
    ]
    return Planned(moves, PlannedStage(separation=described, notes=notes))


def effects_and_joint(
    robot: Robot, options: PlanOptions
) -> tuple[tuple[Effect, Effect], int | None]:
    """Return the two effects to tell apart, and their joint.

    Parameters
    ----------
    robot : Robot
    options : PlanOptions

    Returns
    -------
    effects : tuple of two Effect
    joint : int or None
        None where both are of the whole arm.

    Raises
    ------
    UsageError
        No such effects or joint, or no motion settles which of the effects it is.
    """
    catalogue = catalogue_of(robot)
    for name in options.between:
        if name not in catalogue:
            near = difflib.get_close_matches(name, catalogue, n=1)
            hint = "docs/reference/effects.md lists their names."
            if near:
                hint = f"Did you mean {near[0]}?"
            raise UsageError(f"--between names no effect: {name!r}", hint=hint)
    if len(set(options.between)) != 2:
        hint = "As in --between load_dependent_friction,gear_efficiency."
        raise UsageError(
            "--between takes two effects with a comma between them", hint=hint
        )

    first, second = (catalogue[name] for name in options.between)
    for effect in (first, second):
        if not effect.by_motion:
            hint = f"Record {effect.separate_by}."
            raise UsageError(
                f"no planned motion settles whether it is {effect.name}", hint=hint
            )

    of_whole_arm = all(effect.arm or effect.shared for effect in (first, second))
    if options.joint is None and of_whole_arm:
        return (first, second), None
    if options.joint not in robot.joint_names:
        text = "needs --joint"
        if options.joint:
            text = f"--joint names no joint: {options.joint!r}"
        hint = f"The robot's joints: {', '.join(robot.joint_names)}."
        raise UsageError(text, hint=hint)
    return (first, second), robot.joint_names.index(options.joint)


def _usual_torque(belief: Belief, joint: int | None) -> float:
    """Return the RMS torque [N m] of a joint, or of all, in typical moves."""
    moves = typical(belief, seed=0)
    without_margin = replace(belief, margins=MarginSettings(torque_sigma=0.0))
    torque = without_margin.torque(moves, belief.regressor(moves))
    if joint is not None:
        torque = torque[..., joint]
    return float(np.sqrt(np.mean(torque**2)))


def pool_of(
    belief: Belief,
    joint: int | None,
    options: PlanOptions,
    *,
    each: int = 48,
    paces: tuple[float, ...] = (1.0, 0.3, 0.1),
) -> list[PlannedMove]:
    """Draw moves of the joint alone, with others, and of all; and steady strokes.

    Parameters
    ----------
    belief : Belief
    joint : int, optional
        None for effects of the whole arm.
    options : PlanOptions
    each : int
        Moves that are drawn at each pace.
    paces : tuple of float
        Shares of the speed limits: some effects show at slow motion alone.

    Returns
    -------
    list of PlannedMove

    Raises
    ------
    UsageError
        The joint is locked.
    ConfigError
        No move keeps the limits.
    """
    moving = belief.limits.moving
    if joint is not None and joint not in moving:
        name = belief.robot.joint_names[joint]
        raise UsageError(
            f"joint {name!r} is locked: none of its effects shows", hint="Free it."
        )

    goal = Goal.of(belief, options.seed)
    rng = np.random.default_rng(options.seed)
    shapes = Shapes.over(options.length_s, COARSE_HZ)
    groups = _groups(joint, moving)
    pool: list[PlannedMove] = []
    for pace in paces:
        limits = replace(
            belief.limits,
            speed=pace * belief.limits.speed,
            acceleration=pace * belief.limits.acceleration,
        )
        slower = replace(belief, limits=limits)
        drawn, _ = draw_pool(slower, goal, shapes, groups, each, rng)
        if len(drawn):
            moves, _ = within_limits(slower, drawn, options, "discriminate")
            pool += moves
        elif pace == min(paces) and not pool:
            check_torque(slower, drawn, options)

    for j in moving if joint is None else [joint]:
        pool += _strokes(belief, j, options.length_s, rng)
    return pool


def _groups(joint: int | None, moving: list[int]) -> list[tuple[int, ...]]:
    """Return the joints that move at a time; a third of the moves is of all."""
    all_joints = tuple(moving)
    if joint is None:
        return [all_joints, *combinations(moving, 2)]
    with_one_more = [(joint, k) for k in moving if k != joint]
    groups: list[tuple[int, ...]] = [(joint,), *with_one_more]
    return groups + [all_joints] * max(1, len(groups) // 2)


def _strokes(
    belief: Belief, j: int, seconds: float, rng: np.random.Generator, *, speeds: int = 6
) -> list[PlannedMove]:
    """Return strokes there and back, each as long as a move, in several postures."""
    limits = belief.limits
    fastest = top_speed(limits, j, float(limits.range[j]))
    moves = []
    for speed in np.geomspace(0.03 * fastest, fastest, speeds):
        # One stroke takes half of the time, less a rest before and between and after.
        ramp_s = np.pi * speed / (2.0 * limits.acceleration[j])
        stroke_s = max(seconds / 2 - 1.5 * REST_S, 2.0 * ramp_s)
        stroke_width = speed * (stroke_s - ramp_s)
        drawn = postures_of(limits, 4, rng)
        postures, spans = reachable(belief, j, drawn, share=1.0, widest=0.3)

        for posture, (low, high) in zip(postures, spans, strict=True):
            half_width = min(stroke_width, high - low) / 2
            # It has to reach its speed, with a torque that the joints have.
            if half_width <= ramp_s * speed / 2:
                continue
            if overloads(belief, j, posture[None], speed)[0] > 1.0:
                continue
            middle = float(np.clip(posture[j], low + half_width, high - half_width))
            ends = (middle - half_width, middle + half_width)
            moves.append(
                stroke_move(belief, "stroke", j, posture, ends, [float(speed)])
            )
    return moves


@dataclass(frozen=True)
class Choice:
    """Numbers of the chosen moves of a pool, and the time that they take."""

    moves: list[int]
    duration_s: float


def _chosen(
    separation: Separation, pool: Sequence[PlannedMove], most_s: float
) -> Choice:
    """Take moves one by one that raise the merit most, as long as time is left."""
    durations_s = np.array([move.duration_s for move in pool])
    chosen: list[int] = []
    total = np.zeros_like(separation.prior)
    spent_s = 0.0
    while True:
        is_chosen = np.isin(np.arange(len(pool)), chosen)
        is_candidate = (spent_s + durations_s <= most_s) & ~is_chosen
        if not is_candidate.any():
            return Choice(chosen, spent_s)
        merit = separation.merit(total + separation.grams)
        best = int(np.argmax(np.where(is_candidate, merit, -np.inf)))
        chosen.append(best)
        total = total + separation.grams[best]
        spent_s = spent_s + float(durations_s[best])


def _described(
    separation: Separation,
    choice: Choice,
    *,
    between: list[str],
    joint: str | None,
    special_case: str | None,
    power: float = 0.95,
) -> EffectSeparation:
    """Describe how well chosen moves tell the effects apart.

    Seconds are those of such moves that give a power to both effects.
    """
    total = separation.grams[choice.moves].sum(axis=0)
    outcomes = [separation.least_certain_outcome(total, true) for true in (0, 1)]
    powers = [float(outcome.power) for outcome in outcomes]
    imitations = [outcome.largest_imitation for outcome in outcomes]
    median_left = min(np.median(outcome.rival_leaves) for outcome in outcomes)

    seconds_needed = None
    for factor in np.geomspace(0.01, 1e4, 61):
        if min(float(outcome.longer(factor).power) for outcome in outcomes) >= power:
            seconds_needed = float(choice.duration_s * factor)
            break
    return EffectSeparation(
        between=between,
        joint=joint,
        size=separation.torque_size,
        distance=float(np.sqrt(median_left)),
        power=min(powers),
        seconds_needed=seconds_needed,
        imitated=max(imitations),
        powers=powers,
        imitations=imitations,
        special_case=special_case,
    )
