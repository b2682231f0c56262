"""Refinement: add what a model lacks, as long as logs that were never fitted are predicted better.

Every round an investigation of the training logs, with all effects so far taken out, names the next
effect; model and effects are fitted anew under two accounts: the effect was there all along, or it
came after the file was identified (see `reidentify`). The account that explains the logs of all
stages better is tried first; where these do not tell, the one that foretells the held-out logs
better. The held-out logs decide. An effect that helps the training logs alone, or one joint at the
expense of another, is refused, and said to be; one that has become idle is taken back at the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Candidate, Tried
from seqid_cli.discover.events import Interval
from seqid_cli.discover.floor import NoiseFloor, noise_floor
from seqid_cli.discover.heldout import (
    LEAST_GAIN,
    HeldOutError,
    WholeLogs,
    gain,
    held_out_error,
)
from seqid_cli.discover.investigate import Investigation, investigate
from seqid_cli.discover.loop import Account, Loop, candidates_of_model, with_effects
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.reidentify import Key, Material, Refitted, key_of, refitted
from seqid_cli.discover.results import ClosedLoop, Round
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.search import Search
from seqid_cli.discover.usable import usable_logs
from seqid_cli.discover.withdraw import withdraw_idle
from seqid_cli.identify.prediction import slides_from
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, FittedTerm, fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.diagnosis_schema import MORE_THAN_NOISE
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent

ALL_ALONG = "was there all along"
LATE = "came after the file was identified"
# Of its squared error a joint may lose where others gain: so much, or a share of what these gain.
TOLERATED, EXCHANGE = 0.05, 0.2
ASK = "diagnose says on what it depends, refine --with-unexplained adds a smooth term for it"


def refine(
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    robot: Robot,
    file: ParameterFile,
    *,
    earlier: Mapping[str, Sequence[Recording]],
    options: DiscoverOptions,
    whole: WholeLogs | None = None,
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
    whole : WholeLogs, optional
        The held-out logs as they are, where `held_out` are pieces of them: effects are judged on
        the pieces, the errors before and after are of the logs.

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
    options = on_the_same_samples(options, file.stages, robot)
    material = Material(tuple(training), earlier, robot, options)
    known = fitted_effects(file.stages, robot, unexplained=True)
    bare = msgspec.structs.replace(file.stages, effects=None)
    start = Refitted(bare, tuple(known), _late(file, known, robot))
    rng = np.random.default_rng(options.seed)
    error = held_out_error(held_out, robot, file.stages, options=options.motion)
    loop = Loop(material, tuple(held_out), start, error, [], {}, rng)
    while loop.added < options.max_effects and _round(loop):
        pass
    withdraw_idle(loop, error)
    if options.with_unexplained:
        _add_smooth(loop)
    stages = with_effects(loop.model, robot)
    before, after, said = _reported(loop, error, file.stages, stages, whole)
    return stages, _closed(loop, before, after, (*notes, *more, *said))


def on_the_same_samples(options: DiscoverOptions, stages: Stages, robot: Robot) -> DiscoverOptions:
    """Options by which all models are judged where joints slide by the friction of these stages."""
    slowest = slides_from(TorqueModel.from_stages(stages, robot), options.motion)
    return replace(options, motion=replace(options.motion, slides_from=tuple(slowest.tolist())))


def _reported(
    loop: Loop, error: HeldOutError, came: Stages, left: Stages, whole: WholeLogs | None
) -> tuple[HeldOutError, HeldOutError, tuple[str, ...]]:
    """Errors before and after: of the held-out logs as a whole, where they can be had."""
    if whole is None:
        return error, loop.error, ()
    motion = loop.material.options.motion
    after = whole.error(left, options=motion, unexplained=True)
    before = None if after is None else whole.error(came, options=motion)
    if after is None or before is None:
        said = "the errors before and after are of the pieces of the held-out logs, too"
        return error, loop.error, (said,)
    said = "effects were judged on these pieces; the errors before and after are of the whole logs"
    return before, after, (said,)


def _had(loop: Loop, candidate: Candidate) -> bool:
    """Whether the model has the very effect; a joint may have several ripples and lines."""
    if candidate.effect.wide:
        return False
    kinds = [s.name for s in candidate.effect.settings if not s.continuous]
    return any(
        known.key == candidate.key
        and all(known.settings[kind] == candidate.settings[kind] for kind in kinds)
        for known in candidates_of_model(loop.model.effects)
    )


def _late(file: ParameterFile, known: Sequence[Fitted], robot: Robot) -> frozenset[Key]:
    """Effects of the file that an earlier refinement found to have come late."""
    rounds = file.closed_loop.rounds if file.closed_loop is not None else []
    names = {(r.effect, r.joint) for r in rounds if r.reason == LATE}
    keys = [key for key in map(key_of, known) if key is not None]
    return frozenset(
        key
        for key in keys
        if (key[0], None if key[1] is None else robot.joint_names[key[1]]) in names
    )


def _investigated(loop: Loop) -> Investigation:
    """What the model, with its effects, lacks on the training logs."""
    material, model = loop.material, loop.model
    return investigate(material.now(model), material.robot, model.stages, material.options)


def _round(loop: Loop) -> bool:
    """Look for effects and try each; returns whether one was added."""
    found = _investigated(loop)
    search = found.search
    ordered = sorted(search.accepted, key=lambda t: -search.energies[t.candidate.key])
    added, seen = False, loop.material
    if found.events:
        loop.material = replace(seen, training=quiet(seen.training, found.events))
    for tried in ordered:
        if loop.added < loop.refused.get(tried.candidate.key, 0) or _had(loop, tried.candidate):
            continue
        if loop.added >= loop.material.options.max_effects:
            break
        added |= _try(loop, tried, search)
    loop.material = seen
    return added


def quiet(logs: Sequence[Recording], events: Sequence[Interval]) -> tuple[Recording, ...]:
    """The logs with the events that were found in them marked as not to be used."""
    result = []
    for number, log in enumerate(logs):
        t, valid = log.t - log.t[0], log.valid.copy()
        for event in events:
            if event.scene == number:
                valid &= (t < event.start) | (t > event.end)
        result.append(replace(log, valid=valid))
    return tuple(result)


def _try(loop: Loop, tried: Tried, search: Search) -> bool:
    """Fit the model with one effect more; keep it if the held-out logs agree."""
    training_gain = min(search.marginal(tried).trial.relative, 1.0)
    broad = loop.broad or search.broad
    ways = (search.kept, not search.kept)
    accounts = _ordered(loop, [_account(loop, tried, late=late, broad=broad) for late in ways])
    account = next((a for a in accounts if a.accepted), accounts[0])
    told = _told(loop, tried.candidate, training_gain, account)
    before = [r for r in loop.rounds if (r.effect, r.joint) == (told.effect, told.joint)]
    loop.rounds = [r for r in loop.rounds if r.accepted or r not in before] + [told]
    if account.accepted:
        loop.model, loop.error, loop.broad = account.model, account.error, broad
    else:
        # A joint that loses may only lack an effect of its own: worth another try beside that.
        loop.refused[tried.candidate.key] = loop.added + 1 if account.helps else np.inf
    return account.accepted


def _account(loop: Loop, tried: Tried, *, late: bool, broad: bool) -> Account:
    """The model with one effect more, that came late or was there all along."""
    candidates = [*candidates_of_model(loop.model.effects), tried.candidate]
    came = loop.model.late | ({tried.candidate.key} if late else set())
    model = refitted(loop.material, loop.model, candidates, late=came, kept=late, broad=broad)
    n = loop.material.robot.n
    error = loop.judged(model)
    each = [gain(loop.error, error, [j], loop.rng) for j in range(n)]
    change = gain(loop.error, error, [j for j in tried.columns if j < n], loop.rng)
    tolerated = max(TOLERATED, EXCHANGE * change.value)
    return Account(
        model=model,
        late=late,
        error=error,
        change=change,
        whole=gain(loop.error, error, range(n), loop.rng),
        losing=tuple(j for j, g in enumerate(each) if g.loses and g.value < -tolerated),
    )


def _ordered(loop: Loop, accounts: list[Account]) -> list[Account]:
    """The more likely account first: by all logs that were fitted, else by the held-out ones."""
    first, second = accounts
    n = loop.material.robot.n
    change = gain(loop.explained(first.model), loop.explained(second.model), range(n), loop.rng)
    if not (change.certain or change.loses):
        change = gain(first.error, second.error, range(n), loop.rng)
    return [second, first] if change.certain else [first, second]


def _told(loop: Loop, candidate: Candidate, training_gain: float, account: Account) -> Round:
    names = loop.material.robot.joint_names
    return Round(
        effect=candidate.effect.name,
        joint=None if candidate.joint is None else names[candidate.joint],
        accepted=account.accepted,
        training_gain=float(training_gain),
        held_out_gain=account.change.value,
        interval=(account.change.low, account.change.high),
        reason=_reason(loop, candidate, training_gain, account),
    )


def _reason(loop: Loop, candidate: Candidate, training_gain: float, account: Account) -> str:
    """Why an effect was refused, or when one that was added came."""
    change = account.change
    if account.accepted:
        return LATE if account.late and not loop.material.known else ALL_ALONG
    if candidate.effect.wide and abs(change.value) < LEAST_GAIN:
        return "lies above the low-pass, where the model is not judged"
    if account.losing and change.certain:
        names = [loop.material.robot.joint_names[j] for j in account.losing]
        return f"predicts {', '.join(names)} worse on the held-out logs"
    return (
        f"takes {percent(training_gain)} off the logs that were fitted, but "
        f"{percent(change.value)} ({percent(change.low)} to {percent(change.high)}) "
        "off the held-out ones"
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


def _closed(
    loop: Loop, before: HeldOutError, after: HeldOutError, notes: tuple[str, ...]
) -> ClosedLoop:
    robot = loop.material.robot
    old, new = before.rmse(), after.rmse()
    floor = _floor(loop)
    judged = [j for j in range(robot.n) if np.isfinite(old[j]) and np.isfinite(new[j])]
    names = {j: robot.joint_names[j] for j in judged}
    changes = {names[j]: gain(before, after, [j], loop.rng) for j in judged}
    lost = [f"{name} ({percent(-g.value)})" for name, g in changes.items() if g.loses]
    said = f"predicted worse than before, in squared error where they slide: {', '.join(lost)}"
    loud = [j for j in judged if new[j] > MORE_THAN_NOISE * floor.rms[j]]
    times = ", ".join(f"{names[j]} ({new[j] / floor.rms[j]:.1f} times)" for j in loud)
    more = f"more is left than torque noise and encoder account for: {times}; {ASK}"
    return ClosedLoop(
        rounds=tuple(loop.rounds),
        before={names[j]: float(old[j]) for j in judged},
        after={names[j]: float(new[j]) for j in judged},
        noise_floor={names[j]: float(floor.rms[j]) for j in judged},
        noise_floor_interval={names[j]: floor.interval(j) for j in judged},
        gain_interval={name: (g.low, g.high) for name, g in changes.items()},
        evaluated_on=tuple(dict.fromkeys(str(log.path) for log in loop.held_out)),
        notes=(*notes, *((said,) if lost else ()), *((more,) if loud else ())),
    )


def _floor(loop: Loop) -> NoiseFloor:
    """Noise floor of the held-out logs; the training logs help to find it."""
    material, model = loop.material, loop.model
    logs = [*loop.held_out, *material.training]
    freed = material.freed(logs, model.stages, model.effects)
    scenes = scenes_of(freed, material.robot, model.stages, options=material.options.motion)
    rows = rows_of(scenes)
    left = [whole.residual for whole in base_of(rows, model.stages).whole]
    judged = range(len(loop.held_out))
    return noise_floor(freed, scenes, rows, left, judged)
