"""Plan the motion that tells two effects apart, and say how sure the answer will be."""

import difflib
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import msgspec
import numpy as np

from seqid_cli.discover.scenes import scenes_of as logged
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.registry import catalogue_of
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
from seqid_cli.plan.stages.goal import Goal, Planned
from seqid_cli.plan.stages.search import check_torque, draw_pool, within_limits
from seqid_cli.robot.types import Robot

ENOUGH = 0.9  # power from which a plan is good


def plan_discriminate(
    belief: Belief, stages: Stages, options: PlanOptions, have: Sequence[Recording] = ()
) -> Planned:
    """Choose moves after which a diagnosis, of the logs `have` as well, tells both apart."""
    effects, joint = asked(belief.robot, options)
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
    question = Question.of(belief, effects, joint, scenes[:: max(1, len(scenes) // 12)])
    usual = typical(belief, seed=0)
    torque = belief.torque(usual, belief.regressor(usual), sigmas=0.0)
    torque = torque if joint is None else torque[..., joint]
    size = options.size_share * float(np.sqrt(np.mean(torque**2)))
    logs = logged(have, belief.robot, stages, options=InertiaOptions()) if have else []
    found = separation_of(belief, question, scenes, size, logs)
    nested = [x.name for x, open_ in zip(effects, found.open(), strict=True) if open_]
    if len(nested) == 2:
        one, other = effects
        note = f"no motion tells {one.name} from {other.name}: record {one.separate_by}"
        return Planned([], PlannedStage(notes=[note]))
    chosen, seconds = _chosen(found, pool, options.duration_s)
    names, where = [x.name for x in effects], belief.robot.name_of(joint)
    separation = _described(found, chosen, seconds, names, where, nested)
    moves = [
        msgspec.structs.replace(pool[k], name=f"discriminate_{i:02d}")
        for i, k in enumerate(chosen, start=1)
    ]
    notes = [
        f"if it is {one.name}, these moves may leave it open: record {one.separate_by}"
        for one, power in zip(effects, separation.powers, strict=True)
        if power < ENOUGH
    ]
    return Planned(moves, PlannedStage(separation=separation, notes=notes))


def asked(
    robot: Robot, options: PlanOptions
) -> tuple[tuple[Effect, Effect], int | None]:
    """The two effects and the joint (None where both are of the whole arm)."""
    known = catalogue_of(robot)
    for name in options.between:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = (
                f"Did you mean {near[0]}?"
                if near
                else "docs/effects.md lists their names."
            )
            raise UsageError(f"--between names no effect: {name!r}", hint=hint)
    if len(set(options.between)) != 2:
        hint = "As in --between load_dependent_friction,gear_efficiency."
        raise UsageError(
            "--between takes two effects with a comma between them", hint=hint
        )
    first, second = (known[name] for name in options.between)
    for effect in (first, second):
        if not effect.by_motion:
            hint = f"Record {effect.separate_by}."
            raise UsageError(
                f"no planned motion settles whether it is {effect.name}", hint=hint
            )
    if options.joint is None and all(one.arm or one.shared for one in (first, second)):
        return (first, second), None
    if options.joint not in robot.joint_names:
        text = (
            f"--joint names no joint: {options.joint!r}"
            if options.joint
            else "needs --joint"
        )
        raise UsageError(
            text, hint=f"The robot's joints: {', '.join(robot.joint_names)}."
        )
    return (first, second), robot.joint_names.index(options.joint)


def pool_of(
    belief: Belief,
    joint: int | None,
    options: PlanOptions,
    *,
    each: int = 48,
    paces: tuple[float, ...] = (1.0, 0.3, 0.1),
) -> list[PlannedMove]:
    """Moves of the joint alone, with others, and of all, at several speeds, and steady strokes."""
    moving = belief.limits.moving
    if joint is not None and joint not in moving:
        name = belief.robot.joint_names[joint]
        raise UsageError(
            f"joint {name!r} is locked: none of its effects shows", hint="Free it."
        )
    groups = (
        [(joint,), *((joint, k) for k in moving if k != joint)]
        if joint is not None
        else []
    )
    groups += [tuple(moving)] * max(1, len(groups) // 2)
    if joint is None:
        groups += list(combinations(moving, 2))
    goal = Goal.of(belief, options.seed)
    rng = np.random.default_rng(options.seed)
    shapes = Shapes.over(options.length_s, COARSE_HZ)
    found: list[PlannedMove] = []
    for pace in paces:
        limits = belief.limits
        slowed = replace(
            limits, speed=pace * limits.speed, acceleration=pace * limits.acceleration
        )
        slower = replace(belief, limits=slowed)
        drawn, _ = draw_pool(slower, goal, shapes, groups, each, rng)
        if len(drawn):
            found += within_limits(slower, drawn, options, "discriminate")[0]
        elif pace == min(paces) and not found:
            check_torque(slower, drawn, options)
    for j in moving if joint is None else [joint]:
        found += _strokes(belief, j, options.length_s, rng)
    return found


def _strokes(
    belief: Belief, j: int, seconds: float, rng: np.random.Generator, *, speeds: int = 6
) -> list[PlannedMove]:
    """Strokes there and back, each as long as a move, in several postures."""
    limits, found = belief.limits, []
    fastest = top_speed(limits, j, float(limits.range[j]))
    for speed in np.geomspace(0.03 * fastest, fastest, speeds):
        ramp = np.pi * speed / (2.0 * limits.acceleration[j])
        way = speed * (max(seconds / 2 - 1.5 * REST_S, 2.0 * ramp) - ramp)
        postures, spans = reachable(belief, j, postures_of(limits, 4, rng), 1.0, 0.3)
        for posture, (low, high) in zip(postures, spans, strict=True):
            half = min(way, high - low) / 2
            if (
                half <= ramp * speed / 2
                or overloads(belief, j, posture[None], speed)[0] > 1.0
            ):
                continue
            middle = float(np.clip(posture[j], low + half, high - half))
            ends = middle - half, middle + half
            found.append(
                stroke_move(belief, "stroke", j, posture, ends, [float(speed)])
            )
    return found


def _chosen(
    found: Separation, pool: Sequence[PlannedMove], most_s: float
) -> tuple[list[int], float]:
    """Moves taken one by one that raise the merit most, as long as time is left."""
    seconds = np.array([move.duration_s for move in pool])
    chosen: list[int] = []
    total, spent = np.zeros_like(found.prior), 0.0
    while True:
        open_ = (spent + seconds <= most_s) & ~np.isin(np.arange(len(pool)), chosen)
        if not open_.any():
            return chosen, spent
        value = np.where(open_, found.value(total + found.of), -np.inf)
        best = int(np.argmax(value))
        chosen.append(best)
        total, spent = total + found.of[best], spent + float(seconds[best])


def _described(
    found: Separation,
    chosen: Sequence[int],
    seconds: float,
    between: list[str],
    joint: str | None,
    nested: Sequence[str],
    *,
    power: float = 0.95,
) -> EffectSeparation:
    """How well chosen moves tell the effects apart; seconds of such moves for a power."""
    told = [found.surely(found.of[chosen].sum(axis=0), k) for k in (0, 1)]
    powers, imitations = [float(x.power) for x in told], [x.imitated for x in told]
    longer = (
        float(seconds * factor)
        for factor in np.geomspace(0.01, 1e4, 61)
        if min(float(one.longer(factor).power) for one in told) >= power
    )
    return EffectSeparation(
        between=between,
        joint=joint,
        size=found.size,
        distance=float(np.sqrt(min(np.median(one.left) for one in told))),
        power=min(powers),
        seconds_needed=next(longer, None),
        imitated=max(imitations),
        powers=powers,
        imitations=imitations,
        special_case=nested[0] if nested else None,
    )
