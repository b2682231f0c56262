"""Why what was tried was not taken, in one line each, with its number."""

from collections.abc import Collection, Iterable

from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.select.results import Options, Ranked, Taken
from seqid_cli.params.evidence_schema import RivalEntry
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent

MOST = 6  # of each list that are told


def rivals_of(robot: Robot, taken: Taken, alike: Collection[str] = ()) -> list[RivalEntry]:
    """What was tried in a term's place; `alike` are the effects that could be it as well."""
    others = _each_once(r for r in taken.rivals if r.term.key != taken.term.key)
    told = [one for one in others if one.term.name in alike]
    told += [one for one in others if one not in told]
    ranked = sorted(told[:MOST], key=lambda one: -one.predicted.total)
    return [_rival(robot, one, _beside(one, taken, alike)) for one in ranked]


def tried_at(found: Investigation, robot: Robot, joint: int) -> list[RivalEntry]:
    """What was tried at a joint beside all that was taken, the largest gain first."""
    n = found.ground.n
    here = [r for r in found.found.tried if any(c % n == joint for c in r.term.channels)]
    ranked = sorted(_each_once(here), key=lambda one: -one.predicted.total)
    return [_rival(robot, one, _lacking(one)) for one in ranked[:MOST]]


def _each_once(some: Iterable[Ranked]) -> list[Ranked]:
    """The first of every name at every joint; one smooth function, the best, for all."""
    kept: dict[object, Ranked] = {}
    for one in some:
        kept.setdefault("smooth" if one.term.smooth else one.term.key, one)
    return list(kept.values())


def _rival(robot: Robot, one: Ranked, why_not: str) -> RivalEntry:
    joint = robot.name_of(one.term.joint)
    name = f"some function of {one.term.name}" if one.term.smooth else one.term.name
    return RivalEntry(effect=name, joint=joint, log_gain=one.predicted.total, why_not=why_not)


def _beside(one: Ranked, taken: Taken, alike: Collection[str]) -> str:
    """Why a rival was not taken in a term's place."""
    reach = one.predicted.total / max(taken.one.predicted.total, 1e-300)
    if one.term.name in alike:
        return f"these logs cannot tell the two apart: it reaches {percent(reach)} of the gain"
    if reach <= 0.0:
        return "predicts nothing in its place"
    if reach < 1.0 - Options().tie:
        return f"explains {percent(1.0 - reach)} less"
    more, own = one.term.freedom, taken.term.freedom
    if more > own:
        return f"needs {more} parameters, not {own}, to reach {percent(reach)} of the gain"
    return f"no better: it reaches {percent(reach)} of the gain"


def _lacking(one: Ranked) -> str:
    """Why something was not taken beside all that was."""
    options, told = Options(), one.predicted
    if told.total <= 0.0:
        return "predicts left-out blocks worse than the model without it"
    if told.doubt >= options.doubt:
        chance, most = percent(told.doubt), percent(options.doubt)
        return f"gains nothing in {chance} of drawn blocks of time; {most} is allowed at most"
    if one.gained.evidence <= options.chance:
        evidence = one.gained.evidence
        return f"log evidence of {evidence:.1f}, as of noise; {options.chance:g} is asked at least"
    if told.share <= options.improvement:
        share, least = percent(told.share), percent(options.improvement)
        return f"takes away {share} of the squared error; {least} is asked at least"
    return "was taken, and removed again: not worth it once all was fitted together"
