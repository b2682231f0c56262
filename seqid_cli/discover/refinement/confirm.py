"""What held-out logs say of a refinement: opened after the last decision, they change none."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from msgspec import structs

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.floor import NoiseFloor, encoder_residuals, noise_floor
from seqid_cli.discover.refinement.held_out import HeldOutError, WholeLogs, gain, held_out_error
from seqid_cli.discover.refinement.loop import Refinement, with_effects
from seqid_cli.discover.scenes import scenes_of, usable_logs, with_own_cutoffs
from seqid_cli.discover.select.options import Options
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.params.schema import ClosedLoop
from seqid_cli.shares import percent


def confirm(
    found: Refinement, held_out: Sequence[Recording], whole: WholeLogs | None = None
) -> ClosedLoop:
    """Measure a refinement on logs that had no say in it, before and after on the same samples.

    `whole`: the held-out logs as they are, where `held_out` are pieces of them. Each round's
    gain is beside the model before, and is confirmed where that is certainly more than nothing.
    """
    robot, options = found.material.robot, found.material.options
    held_out, notes = usable_logs(held_out, robot)
    motion = with_own_cutoffs(held_out, robot, found.came, options.motion)
    models = [found.came, *(with_effects(m, robot) for m in (found.without, *found.steps[1:]))]
    of_all = whole.errors(models, motion) if whole is not None else []
    errors = of_all or [held_out_error(held_out, robot, stages, motion) for stages in models]
    which = "the whole" if of_all else "pieces of the"
    more = () if whole is None else (f"errors are of {which} held-out logs",)
    rounds, names = _confirmed(found, errors[1:]), robot.joint_names
    before, after = errors[0], errors[-1] if found.added else errors[0]
    new, floor = after.rmse(), _floor(found, held_out, motion)
    judged = [j for j in range(robot.n) if np.isfinite(new[j])]
    changes = {names[j]: gain(before, after, [j]) for j in judged}
    lost = {n: -g.value for n, g in changes.items() if g.loses and -g.value > Options.small}
    worse = ", ".join(f"{name} ({percent(share)})" for name, share in lost.items())
    said = f"predicted worse than before, in squared error where they slide: {worse}"
    times = {names[j]: float(new[j] / floor.rms[j]) for j in judged}
    accepted = [told for told in rounds if told.accepted]
    return ClosedLoop(
        verdict="good" if all(told.confirmed for told in accepted) else "poor",
        rounds=accepted,
        refused=[told for told in rounds if not told.accepted],
        before=before.by_joint(names),
        after=after.by_joint(names),
        noise_floor={names[j]: float(floor.rms[j]) for j in judged},
        noise_floor_interval={names[j]: list(floor.interval(j)) for j in judged},
        gain_interval={name: g.limits for name, g in changes.items() if g.limits},
        evaluated_on=list(dict.fromkeys(str(log.path) for log in held_out)),
        notes=[
            *(*found.notes, *notes, *more),
            *((said,) if lost else ()),
            *excess_note(times, smooth=options.with_unexplained),
            *floor.doubts(new, robot.joints),
        ],
    )


def _confirmed(found: Refinement, errors: Sequence[HeldOutError]) -> list[RefinementRound]:
    """The rounds, each effect that was added with what it gains on the held-out logs."""
    robot, rounds, steps = found.material.robot, list(found.rounds), pairwise(errors)
    for k, told in enumerate(rounds):
        if told.accepted:
            own = range(robot.n) if told.joint is None else [robot.joint_names.index(told.joint)]
            change = gain(*next(steps), own)
            rounds[k] = structs.replace(
                told, held_out_gain=change.value, interval=change.limits, confirmed=change.certain
            )
    return rounds


def excess_note(times: Mapping[str, float], *, smooth: bool) -> tuple[str, ...]:
    """Say which joints have so many `times` the noise floor left, and what to do."""
    said = ", ".join(f"{name} ({x:.1f} times)" for name, x in times.items() if x > MORE_THAN_NOISE)
    ask = "diagnose says on what it depends"
    ask += "" if smooth else ", refine --with-unexplained adds a smooth term for it"
    note = f"more is left than torque noise and encoder account for: {said}; {ask}"
    return (note,) if said else ()


def _floor(found: Refinement, held_out: Sequence[Recording], options: InertiaOptions) -> NoiseFloor:
    """Noise floor of the held-out logs; the training logs help to find it."""
    material = replace(found.material, options=replace(found.material.options, motion=options))
    model, logs = found.model, (*held_out, *material.training)
    freed = [material.without(log, model.stages, model.effects) for log in logs]
    scenes = scenes_of(freed, material.robot, model.stages, options=options)
    left, echo = [residual_of(scene) for scene in scenes], encoder_residuals(freed, scenes)
    return noise_floor(freed, scenes, left, echo, judged=len(held_out))
