"""What held-out logs say of a refinement: opened after the last decision, they change none."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from msgspec import structs

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.encoder import encoder_residuals
from seqid_cli.discover.noise.floor import NoiseFloor, noise_floor
from seqid_cli.discover.refinement.held_out import HeldOutError, WholeLogs, gain, held_out_error
from seqid_cli.discover.refinement.loop import with_effects
from seqid_cli.discover.refinement.rounds import Refinement
from seqid_cli.discover.scenes import scenes_of, with_own_cutoffs
from seqid_cli.discover.survey.usable import usable_logs
from seqid_cli.logs.recording import Recording
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.params.schema import ClosedLoop, JointRmse, Stages
from seqid_cli.shares import percent


def confirm(
    found: Refinement, held_out: Sequence[Recording], whole: WholeLogs | None = None
) -> ClosedLoop:
    """Measure a refinement on logs that had no say in it.

    `whole`: the held-out logs as they are, where `held_out` are pieces of them. Errors before and
    after are on the same samples. Each round has its own gain beside the model before it, and is
    confirmed where that is certainly more than nothing.
    """
    robot, options = found.material.robot, found.material.options
    held_out, notes = usable_logs(held_out, robot)
    motion = with_own_cutoffs(held_out, robot, found.came, options.motion)
    material = replace(found.material, options=replace(options, motion=motion))
    found = replace(found, material=material)
    models = [found.came, *(with_effects(m, robot) for m in (found.without, *found.steps[1:]))]
    errors, more = _errors(found, models, held_out, whole)
    rounds, names, number = list(found.rounds), robot.joint_names, 1
    for k, told in enumerate(rounds):
        if told.accepted:
            own = [names.index(told.joint)] if told.joint is not None else range(robot.n)
            change = gain(errors[number], errors[number + 1], own)
            number += 1
            rounds[k] = structs.replace(
                told, held_out_gain=change.value, interval=change.limits, confirmed=change.certain
            )
    errors = errors if found.steps[1:] else errors[:1]
    logs = tuple(dict.fromkeys(str(log.path) for log in held_out))
    return _closed(found, rounds, errors, _floor(found, held_out), logs, (*notes, *more))


def excess_note(times: Mapping[str, float], *, smooth: bool) -> tuple[str, ...]:
    """Say which joints are left with more than noise, and what to do; nothing where none is.

    `times`: how many times the noise floor each joint's error is. `smooth`: whether smooth terms
    were allowed already.
    """
    said = [f"{name} ({x:.1f} times)" for name, x in times.items() if x > MORE_THAN_NOISE]
    if not said:
        return ()
    ask = "diagnose says on what it depends"
    ask += "" if smooth else ", refine --with-unexplained adds a smooth term for it"
    return (f"more is left than torque noise and encoder account for: {', '.join(said)}; {ask}",)


def _errors(
    found: Refinement,
    models: Sequence[Stages],
    held_out: Sequence[Recording],
    whole: WholeLogs | None,
) -> tuple[list[HeldOutError], tuple[str, ...]]:
    """Errors of all models: of the held-out logs as a whole, where they can be had."""
    options, robot = found.material.options.motion, found.material.robot
    there = [whole.error(stages, options=options) for stages in models if whole is not None]
    known = [error for error in there if error is not None]
    if len(known) == len(models):
        return known, ("errors are of the whole held-out logs",)
    note = () if whole is None else ("errors are of pieces of the held-out logs",)
    return [held_out_error(held_out, robot, stages, options=options) for stages in models], note


def _closed(
    found: Refinement,
    rounds: list[RefinementRound],
    errors: Sequence[HeldOutError],
    floor: NoiseFloor,
    logs: tuple[str, ...],
    notes: tuple[str, ...],
) -> ClosedLoop:
    names = found.material.robot.joint_names
    before, after = errors[0], errors[-1]
    new = after.rmse()
    judged = [j for j in range(len(names)) if np.isfinite(new[j])]
    changes = {names[j]: gain(before, after, [j]) for j in judged}
    lost = [f"{name} ({percent(-g.value)})" for name, g in changes.items() if g.loses]
    said = f"predicted worse than before, in squared error where they slide: {', '.join(lost)}"
    times = {names[j]: float(new[j] / floor.rms[j]) for j in judged}
    more = excess_note(times, smooth=found.material.options.with_unexplained)
    return ClosedLoop(
        verdict="good" if all(told.confirmed for told in rounds if told.accepted) else "poor",
        rounds=[told for told in rounds if told.accepted],
        refused=[told for told in rounds if not told.accepted],
        before=_by_joint(before, names),
        after=_by_joint(after, names),
        noise_floor={names[j]: float(floor.rms[j]) for j in judged},
        noise_floor_interval={names[j]: list(floor.interval(j)) for j in judged},
        gain_interval={name: g.limits for name, g in changes.items() if g.limits},
        evaluated_on=list(logs),
        notes=[
            *found.notes,
            *notes,
            *((said,) if lost else ()),
            *more,
            *floor.doubts(new, found.material.robot.joints),
        ],
    )


def _by_joint(error: HeldOutError, names: Sequence[str]) -> dict[str, JointRmse]:
    """Errors of the joints that slide."""
    columns = (error.rmse(), error.rmse_inside(), error.rmse_outside(), error.share_outside())
    every = zip(names, np.stack(columns, axis=1).tolist(), strict=True)
    return {
        name: JointRmse(
            rmse=rmse,
            rmse_inside=inside if np.isfinite(inside) else None,
            rmse_outside=outside if np.isfinite(outside) else None,
            share_outside=share,
        )
        for name, (rmse, inside, outside, share) in every
        if np.isfinite(rmse)
    }


def _floor(found: Refinement, held_out: Sequence[Recording]) -> NoiseFloor:
    """Noise floor of the held-out logs; the training logs help to find it."""
    material, model = found.material, found.steps[-1]
    logs = [*held_out, *material.training]
    freed = [material.without(log, model.stages, model.effects) for log in logs]
    scenes = scenes_of(freed, material.robot, model.stages, options=material.options.motion)
    left, echo = [residual_of(scene) for scene in scenes], encoder_residuals(freed, scenes)
    return noise_floor(freed, scenes, left, echo, judged=len(held_out))
