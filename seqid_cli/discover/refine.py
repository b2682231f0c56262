"""Refinement: add what a model lacks, as long as logs that were never fitted are predicted better.

Every round an investigation of the training logs, with all effects so far taken out, names the next
effect; model and effects are fitted anew (see `reidentify`), and the held-out logs decide. An
effect that helps the training logs alone is refused, and said to be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Candidate, Tried
from seqid_cli.discover.floor import noise_floor
from seqid_cli.discover.heldout import (
    LEAST_GAIN,
    Gain,
    HeldOutError,
    gain,
    held_out_error,
)
from seqid_cli.discover.investigate import Investigation, investigate
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.reidentify import Material, Refitted, refitted
from seqid_cli.discover.results import ClosedLoop, Round
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.usable import usable_logs
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import (
    Fitted,
    FittedEffect,
    FittedTerm,
    as_stage,
    fitted_effects,
)
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]


@dataclass
class Loop:
    """The model as it grows, its error on the held-out logs, and what was tried."""

    material: Material
    held_out: tuple[Recording, ...]
    model: Refitted
    error: HeldOutError
    rounds: list[Round]
    refused: set[tuple[str, int | None]]
    rng: np.random.Generator

    @property
    def added(self) -> int:
        """Number of effects added."""
        return sum(r.accepted for r in self.rounds)

    def judged(self, model: Refitted) -> HeldOutError:
        """Error of a model on the held-out logs."""
        stages = with_effects(model, self.material.robot)
        motion = self.material.options.motion
        return held_out_error(
            self.held_out, self.material.robot, stages, options=motion, unexplained=True
        )


def refine(
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    robot: Robot,
    file: ParameterFile,
    *,
    earlier: Mapping[str, Sequence[Recording]],
    options: DiscoverOptions,
) -> tuple[Stages, ClosedLoop]:
    """Add effects to a model and prove each on held-out logs.

    Parameters
    ----------
    training : sequence of Recording
        Logs to fit.
    held_out : sequence of Recording
        Logs to judge by; never fitted.
    robot : Robot
    file : ParameterFile
        The model as it comes in.
    earlier : mapping of stage name to recordings
        Logs that the file's stages were identified from, where they are at hand.
    options : DiscoverOptions

    Returns
    -------
    tuple of Stages and ClosedLoop
        The refined model, and the errors before and after.

    Raises
    ------
    InputError
        If a log carries neither torque nor current.
    """
    training, notes = usable_logs(training, robot)
    held_out, more = usable_logs(held_out, robot)
    material = Material(tuple(training), earlier, robot, options)
    known = fitted_effects(file.stages, robot, unexplained=True)
    start = Refitted(msgspec.structs.replace(file.stages, effects=None), tuple(known))
    rng = np.random.default_rng(options.seed)
    error = held_out_error(held_out, robot, file.stages, options=options.motion)
    loop = Loop(material, tuple(held_out), start, error, [], set(), rng)
    while loop.added < options.max_effects and _round(loop):
        pass
    if options.with_unexplained:
        _add_smooth(loop)
    return with_effects(loop.model, robot), _closed(loop, error, (*notes, *more))


def _investigated(loop: Loop) -> Investigation:
    """What the model, with its effects, lacks on the training logs."""
    material, model = loop.material, loop.model
    freed = material.freed(material.training, model.stages, model.effects)
    return investigate(freed, material.robot, model.stages, material.options)


def _round(loop: Loop) -> bool:
    """Look for effects and try each; returns whether one was added."""
    found = _investigated(loop)
    search = found.search
    ordered = sorted(search.accepted, key=lambda t: -search.energies[t.candidate.key])
    added = False
    for tried in ordered:
        if tried.candidate.key in loop.refused or loop.added >= loop.material.options.max_effects:
            continue
        added |= _try(loop, tried, search.marginal(tried).trial.relative, kept=search.kept)
    return added


def _try(loop: Loop, tried: Tried, training_gain: float, *, kept: bool) -> bool:
    """Fit the model with one effect more; keep it if the held-out logs agree."""
    candidates = [*_candidates(loop.model.effects), tried.candidate]
    model = refitted(loop.material, loop.model.stages, candidates, kept=kept)
    n = loop.material.robot.n
    joints = [j for j in tried.columns if j < n]
    error = loop.judged(model)
    change = gain(loop.error, error, joints, loop.rng)
    whole = gain(loop.error, error, range(n), loop.rng)
    accepted = change.certain and whole.value > 0.0
    loop.rounds.append(_told(loop, tried.candidate, training_gain, change, accepted))
    if accepted:
        loop.model, loop.error = model, error
    else:
        loop.refused.add(tried.candidate.key)
    return accepted


def _candidates(effects: Sequence[Fitted]) -> list[Candidate]:
    return [
        Candidate(f.effect, f.joint, dict(f.settings), below=f.effect.wide)
        for f in effects
        if isinstance(f, FittedEffect)
    ]


def _told(
    loop: Loop, candidate: Candidate, training_gain: float, change: Gain, accepted: bool
) -> Round:
    names = loop.material.robot.joint_names
    reason = ""
    if not accepted and candidate.effect.wide and abs(change.value) < LEAST_GAIN:
        reason = "lies above the low-pass, where the model is not judged"
    elif not accepted:
        reason = (
            f"takes {100 * training_gain:.1f} % off the logs that were fitted, but "
            f"{100 * change.value:.1f} % ({100 * change.low:.1f} to {100 * change.high:.1f} %) "
            "off the held-out ones"
        )
    return Round(
        effect=candidate.effect.name,
        joint=None if candidate.joint is None else names[candidate.joint],
        accepted=accepted,
        training_gain=float(training_gain),
        held_out_gain=change.value,
        interval=(change.low, change.high),
        reason=reason,
    )


def _add_smooth(loop: Loop) -> None:
    """Add smooth terms of no known cause where they help the held-out logs."""
    found = _investigated(loop)
    for smooth in (*found.outside, *(d for d in found.dependences if d.quantities)):
        term = smooth.rivals[0].term(smooth.trials[0].coefficients)
        if term is None:
            continue
        model = replace(loop.model, effects=(*loop.model.effects, FittedTerm(term)))
        error = loop.judged(model)
        change = gain(loop.error, error, [smooth.joint], loop.rng)
        loop.rounds.append(
            Round(
                effect="unexplained",
                joint=loop.material.robot.joint_names[smooth.joint],
                accepted=change.certain,
                training_gain=smooth.relative,
                held_out_gain=change.value,
                interval=(change.low, change.high),
                reason="" if change.certain else "does not help the held-out logs",
            )
        )
        if change.certain:
            loop.model, loop.error = model, error


def with_effects(model: Refitted, robot: Robot) -> Stages:
    """The stages with the effects written into them."""
    effects = [
        as_stage(f, robot) if isinstance(f, FittedEffect) else f.term.to_stage(robot)
        for f in model.effects
    ]
    return msgspec.structs.replace(model.stages, effects=effects)


def _closed(loop: Loop, before: HeldOutError, notes: tuple[str, ...]) -> ClosedLoop:
    robot = loop.material.robot
    old, new, floor = before.rmse(), loop.error.rmse(), _floor(loop)
    judged = [j for j in range(robot.n) if np.isfinite(old[j]) and np.isfinite(new[j])]
    names = {j: robot.joint_names[j] for j in judged}
    intervals = {names[j]: gain(before, loop.error, [j], loop.rng) for j in judged}
    return ClosedLoop(
        rounds=tuple(loop.rounds),
        before={names[j]: float(old[j]) for j in judged},
        after={names[j]: float(new[j]) for j in judged},
        noise_floor={names[j]: float(floor[j]) for j in judged},
        gain_interval={name: (g.low, g.high) for name, g in intervals.items()},
        evaluated_on=tuple(str(log.path) for log in loop.held_out),
        notes=notes,
    )


def _floor(loop: Loop) -> Array:
    """Noise floor (n,) N m of the held-out logs."""
    material, model = loop.material, loop.model
    freed = material.freed(loop.held_out, model.stages, model.effects)
    scenes = scenes_of(freed, material.robot, model.stages, options=material.options.motion)
    rows = rows_of(scenes)
    left = [whole.residual for whole in base_of(rows, model.stages).whole]
    floor: Array = noise_floor(freed, scenes, rows, left).rms
    return floor
