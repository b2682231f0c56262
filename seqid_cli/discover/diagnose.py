"""Diagnosis: what the model lacks on these logs, with the evidence.

Every effect that an investigation arrives at is compared with all others (see `confusable`) and
with smooth functions of everything that was measured (see `dependence`): what these explain better
is not understood, and is said to be so.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.aside import EventAside, events_aside
from seqid_cli.discover.candidates import Tried
from seqid_cli.discover.company import beside_rest, less_sure, ordered
from seqid_cli.discover.confusable import certainty, event_confidence, rivalries
from seqid_cli.discover.dependence import Dependence
from seqid_cli.discover.doubtful import WORSE
from seqid_cli.discover.events import Interval
from seqid_cli.discover.gates import SMOOTH
from seqid_cli.discover.investigate import Investigation, Named, investigate
from seqid_cli.discover.loud import expected, looks_like, louder_joints
from seqid_cli.discover.notes import (
    file_notes,
    free_base_notes,
    loud_notes,
    offset_notes,
    outside_notes,
    shown_offsets,
)
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.results import (
    Diagnosis,
    Event,
    Finding,
    Hidden,
    JointResidual,
    Unexplained,
    Verdict,
)
from seqid_cli.discover.rows import BLOCK_S, SAMPLES_PER_CUTOFF
from seqid_cli.discover.search import ENOUGH_S, SHAPE, Search
from seqid_cli.discover.select.investigation import investigate_by_evidence
from seqid_cli.discover.stationary import beyond_chance
from seqid_cli.discover.system import Trial
from seqid_cli.discover.usable import usable_logs
from seqid_cli.discover.whiteness import white
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.apply import without_effects
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

SLOW_NOISE = 3.0  # times the level of other quantities, that a dependence on time must reach
CLEAR = 0.5  # share of a smooth dependence that needs no comparison with noise
HIDDEN = 0.2  # visible share below which an effect is said to be invisible


def diagnose(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: DiscoverOptions,
    aside: Iterable[Recording] = (),
) -> Diagnosis:
    """Find what a model lacks on these logs.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs with torque or current.
    robot : Robot
    stages : Stages
        The model: at least friction or a rigid body; effects that it has are not missing.
    options : DiscoverOptions
    aside : iterable of Recording
        Pieces of logs in which nothing but events is looked for (see `gather`).

    Raises
    ------
    InputError
        If a log carries neither torque nor current, or if all logs' torque is an echo of the
        command (see `usable_logs`).
    """
    motion = options.motion
    known = fitted_effects(stages, robot, unexplained=True)
    kept, notes = usable_logs(recordings, robot)
    logs, others = (
        [
            without_effects(log, robot, stages, known, motion=motion.motion, source=motion.source)
            for log in some
        ]
        for some in (kept, aside)
    )
    look = investigate_by_evidence if options.by_evidence else investigate
    investigation = look(logs, robot, stages, options)
    apart = events_aside(investigation, others, robot, stages, options)
    found = described(investigation, robot, apart)
    return replace(found, notes=(*notes, *found.notes))


def described(found: Investigation, robot: Robot, aside: Sequence[EventAside] = ()) -> Diagnosis:
    """Turn a search, and the events beside it, into findings, unexplained parts and a verdict."""
    wider = wider_errors(found.search)
    findings = [
        _finding(found, robot, tried, more)
        for tried, more in zip(found.search.accepted, wider, strict=True)
    ]
    rest = [_unexplained(robot, smooth) for smooth in found.outside] + _left(found, robot)
    findings = [beside_rest(finding, rest) for finding in findings]
    ordinary = expected(found)
    louder = louder_joints(found, ordinary)
    beyond_noise = {robot.joint_names[one.joint]: one.share for one in louder}
    if found.events or aside:
        energies = _event_energies(found)
        contact = _contact(found, aside, energies)
        findings.append(less_sure(contact, _apart(found, robot, beyond_noise, energies)))
    loud = [one for one in louder if one.told]
    told = [robot.joint_names[one.joint] for one in loud]
    findings = ordered(findings, beyond_noise, told)
    if not findings and not rest:
        rest = [
            Unexplained(robot.joint_names[one.joint], looks_like(found, one.joint), one.share)
            for one in loud
        ]
    rest = _largest_of_each(rest)
    offsets = shown_offsets(found)
    named = {part.joint for part in rest} | {*told, *(robot.joint_names[j] for j in offsets)}
    return Diagnosis(
        verdict=_verdict(findings, rest),
        findings=tuple(findings),
        unexplained=tuple(rest),
        joints=_joints(found, robot),
        events=(
            *(_event(found, robot, event) for event in found.events),
            *(one.event for one in aside),
        ),
        hidden=_hidden(found, robot),
        notes=(
            *offset_notes(offsets, robot),
            *loud_notes(loud, robot),
            *file_notes(found, robot, ordinary, named),
            *outside_notes(found, robot, ordinary),
            *free_base_notes(found, robot),
            *found.floor.doubts(np.minimum(found.search.rms(), found.start), robot.joint_names),
        ),
    )


def _largest_of_each(rest: Sequence[Unexplained]) -> list[Unexplained]:
    """One entry per joint, the largest share first."""
    ordered = sorted(rest, key=lambda u: -u.share)
    return list({u.joint: u for u in reversed(ordered)}.values())[::-1]


def _contact(
    found: Investigation, aside: Sequence[EventAside], energies: Sequence[float]
) -> Finding:
    """The finding that stands for all events; `energies` are those of the search's."""
    effect = CATALOGUE["external_contact"]
    gained = sum(max(t.trial.total, 0) for t in found.search.accepted)
    inside = sum(energies) + sum(one.energy for one in aside)
    ratios = [event.score / found.gates.event for event in found.events]
    confidence = event_confidence(max([*ratios, *(one.ratio for one in aside)]))
    return Finding(
        effect=effect.name,
        joint=None,
        confidence=confidence,
        name_confidence=confidence,
        explains=float(inside / max(inside + gained, 1e-300)),
        confusable_with=(),
        separate_by=effect.separate_by,
        gain=0.0,
        clean_gain=0.0,
        note=f"{len(found.events) + len(aside)} interval(s), left out of the search",
    )


def _event_energies(found: Investigation) -> list[float]:
    """Squared residual inside each event above what the rest of the logs has, in noise units."""
    search = found.search
    energies = []
    left = search.residual(search.system())
    for event in found.events:
        scene = search.stage.scenes[event.scene]
        t = scene.motion.t - scene.motion.t[0]
        at = (t >= event.start) & (t <= event.end)
        scaled = left[event.scene][at] / search.noise[: search.stage.rows.n]
        thin = SAMPLES_PER_CUTOFF * scene.motion.lowpass.cutoff_hz / scene.motion.rate_hz
        energies.append(thin * float(np.sum(np.maximum(scaled**2 - 1.0, 0.0))))
    return energies


def _apart(
    found: Investigation, robot: Robot, unknown: Mapping[str, float], energies: Sequence[float]
) -> float:
    """Share of the clearest event in what it and all else unknown at its joints amount to.

    A push stands alone. Where much is `unknown` (share of a joint's squared residual) all along,
    the largest moment of it may be nothing else.
    """
    rows = found.search.stage.rows
    beyond = [unknown.get(name, 0.0) * rows.count(j) for j, name in enumerate(robot.joint_names)]
    shares = [1.0 if not found.events else 0.0]
    for event, energy in zip(found.events, energies, strict=True):
        shares.append(energy / max(energy + max(beyond[j] for j in event.joints), 1e-300))
    return max(shares)


def _event(found: Investigation, robot: Robot, event: Interval) -> Event:
    log = found.logs[event.scene]
    return Event(
        log=str(log.path),
        start=log.offset + event.start,
        end=log.offset + event.end,
        joints=tuple(robot.joint_names[j] for j in event.joints),
    )


def _verdict(findings: Sequence[Finding], rest: Sequence[Unexplained]) -> Verdict:
    if findings:
        return "effect_found"
    return "unexplained" if rest else "nothing_missing"


def wider_errors(search: Search) -> list[Array]:
    """How much wider the coefficients of each accepted effect scatter than white noise would.

    From the scatter over blocks of time, which has noise that lasts and shapes that are not quite
    right.
    """
    system = search.system()
    white, block = np.diag(system.covariance), np.diag(system.block_covariance())
    wider = np.sqrt(np.maximum(block / np.maximum(white, 1e-300), 1.0))
    return [wider[at] for _, at in search.placed(system)]


def _finding(found: Investigation, robot: Robot, tried: Tried, wider: Array) -> Finding:
    """Describe one accepted effect, its standard errors `wider` (k,) times white noise's."""
    search = found.search
    others = search.without(tried)
    system = others.system()
    again = search.stage.try_all(system, [tried.candidate])[0]
    stated = _with_errors_of_the_file(others, again)
    touched = [j for j in tried.columns if j < robot.n]
    named = found.named.get(tried.candidate.key) or _named(found, others, again, touched)
    candidate, trial = tried.candidate, again.trial
    effect = candidate.effect
    joint = None if candidate.joint is None else robot.joint_names[candidate.joint]
    covariance = stated.covariance * np.outer(wider, wider)
    values = effect.reported(
        robot, candidate.joint, candidate.settings, stated.coefficients, covariance
    )
    return Finding(
        effect=effect.name,
        joint=joint,
        confidence=named.confidence,
        name_confidence=named.by_itself,
        explains=_explains(found, tried),
        confusable_with=named.others,
        separate_by=effect.separate_by,
        gain=trial.relative,
        clean_gain=found.gates.clean.get(effect.name, 0.0),
        parameters=tuple(values),
        settings=candidate.settings,
        note=effect.lacking(robot, candidate.joint),
    )


def _named(found: Investigation, others: Search, tried: Tried, touched: Collection[int]) -> Named:
    """How sure the name of an accepted effect is beside all others."""
    every = tuple(CATALOGUE.values())
    rivals = rivalries(tried, others.ranked(every, others.system(), near=touched, doubtful=True))
    clear_of_gate = 1.0 - float(np.exp(-tried.trial.relative / found.gates.least_of(tried)))
    names = dict.fromkeys(r.tried.candidate.effect.name for r in rivals if r.confusable)
    return Named(
        certainty([r for r in rivals if not r.confusable]) * clear_of_gate,
        certainty(rivals) * clear_of_gate,
        tuple(name for name in names if name != tried.candidate.effect.name),
    )


def _with_errors_of_the_file(others: Search, tried: Tried) -> Trial:
    """Coefficients and covariance with a base no firmer than the file says of itself."""
    if others.inflation >= 1.0:
        return tried.trial
    system = replace(others, inflation=1.0).system()
    return others.stage.try_all(system, [tried.candidate])[0].trial


def _explains(found: Investigation, tried: Tried) -> float:
    """What `share_above` says of the effect's joints, on left-out folds."""
    search = found.search
    joints = [j for j in sorted(tried.columns) if j < search.stage.rows.n]
    before, after = search.without(tried).rms()[joints], search.rms()[joints]
    return share_above(before, after, found.floor.rms[joints])


def share_above(before: Array, after: Array, floor: Array) -> float:
    """Share of the variance above the noise floor that goes from `before` to `after`, (n,) N m.

    All of it where no more than the floor is left.
    """
    scale = np.maximum(after, 1e-12)
    above = float(np.sum((before**2 - floor**2) / scale**2))
    taken = float(np.sum((before**2 - after**2) / scale**2))
    return float(np.clip(taken / max(above, 1e-300), 0.0, 1.0))


def _unexplained(robot: Robot, smooth: Dependence) -> Unexplained:
    curve = smooth.rivals[0].curve(smooth.trials[0].coefficients)
    return Unexplained(
        joint=robot.joint_names[smooth.joint],
        depends_on=smooth.quantities,
        share=float(np.clip(smooth.relative, 0.0, 1.0)),
        curve=None if curve is None else (tuple(curve[0].tolist()), tuple(curve[1].tolist())),
    )


def _left(found: Investigation, robot: Robot) -> list[Unexplained]:
    """What smooth functions still find after all effects."""
    return [
        _unexplained(robot, smooth)
        for smooth in found.dependences
        if smooth.quantities
        and smooth.relative >= _least_smooth(found, smooth)
        and not _is_shape(found.search, smooth)
        and (mended := _mended(found.search, smooth)) >= 1.0 - WORSE**2
        and (mended >= CLEAR or beyond_chance(found.search, smooth))
    ]


def _least_smooth(found: Investigation, smooth: Dependence) -> float:
    """Share from which a smooth dependence counts.

    Slow noise is itself a function of time, and its share varies more in short logs.
    """
    least = found.gates.least(SMOOTH)
    if smooth.quantities[0] != "time":
        return least
    few = ENOUGH_S / (BLOCK_S * len(found.search.stage.rows.fold))
    return SLOW_NOISE * max(1.0, float(np.sqrt(few))) * least


def _mended(search: Search, smooth: Dependence) -> float:
    """Share of the file's squared error that it takes away where the joint was not fitted.

    Less than its share of what a free base leaves there, which few rows make foretell badly.
    """
    rest = 1.0 - min(smooth.relative, 1.0)
    return 1.0 - float(search.excess()[smooth.joint]) ** 2 * rest


def _is_shape(search: Search, smooth: Dependence) -> bool:
    """Whether what is left is small beside what the joint's effects explain."""
    j = smooth.joint
    energy = smooth.relative * float((search.noise[j] / search.bare[j]) ** 2)
    return any(
        energy < SHAPE * search.energies[a.candidate.key] for a in search.accepted if j in a.columns
    )


def _joints(found: Investigation, robot: Robot) -> dict[str, JointResidual]:
    search = found.search
    rows, rms = search.stage.rows, search.rms()
    left = search.residual(search.system())
    whites = white(search.stage.scenes, rows, left)
    return {
        name: JointResidual(
            rmse=float(found.start[j]),
            noise_floor=float(found.floor.rms[j]),
            noise_floor_interval=found.floor.interval(j),
            white=bool(whites[j]),
            rmse_explained=float(rms[j]),
            samples=rows.count(j),
        )
        for j, name in enumerate(robot.joint_names)
    }


def _hidden(found: Investigation, robot: Robot) -> tuple[Hidden, ...]:
    visible: dict[tuple[str, int | None], float] = {}
    accepted = {tried.candidate.key for tried in found.search.accepted}
    for tried in found.result.ranked:
        key = tried.candidate.key
        if key in accepted:
            continue
        visible[key] = max(visible.get(key, 0.0), tried.trial.visible)
    return tuple(
        Hidden(name, None if joint is None else robot.joint_names[joint], share)
        for (name, joint), share in sorted(visible.items(), key=lambda item: item[1])
        if share < HIDDEN
    )
