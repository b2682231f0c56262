"""Do the stated errors hold? Estimates, stated standard errors and truth over many drawn arms.

    python -m tests.studies --only coverage --rig planar --seeds 0:40 --jobs 2

Every seed draws an arm anew (one joint, two joints planar, six joints), records its logs and runs
friction, gravity, imu-calib and inertia on the files. Noise (white, or half its variance 1/f) and
encoder (fine or coarse) change from seed to seed. What a seed gives is
kept as one JSON line in `<cache>/coverage/<rig>.jsonl`, so that a run that was cut short goes on
where it stopped; lines of another state of the package stay and do not count.

Seeds 0 to 999 are for tuning: whoever sets a number may look at them. Seeds from 10000 on are for
judging: nothing is set by them. A table never has both.
"""

from argparse import Namespace
from collections.abc import Sequence

from tests.studies.coverage.cases import RIGS, case_of
from tests.studies.coverage.score import Result, score
from tests.studies.coverage.tables import tables_of
from tests.studies.records import package_sources, results

TUNING = range(1000)
FIRST_JUDGING = 10_000
SEEDS = "10000:10200"  # of the document
QUICK = "0:2"
NAMES = {"one": "One joint", "planar": "Two joints, planar", "six": "Six joints"}


def study(chosen: Namespace) -> str:
    """Run what is not there yet, and make the tables."""
    seeds = seeds_of(chosen.seeds or (QUICK if chosen.quick else SEEDS))
    rigs = [chosen.rig] if chosen.rig else ["planar"] if chosen.quick else list(RIGS)
    parts, program = [], package_sources()
    for rig in rigs:
        if rig not in RIGS:
            raise SystemExit(f"coverage has no rig {rig!r}, only {', '.join(RIGS)}")
        cases = [case_of(rig, seed) for seed in seeds]
        kept = results(
            {case.label: case for case in cases},
            score,
            Result,
            chosen.cache / "coverage" / f"{rig}.jsonl",
            sources=program,
            run=not chosen.tables,
            processes=chosen.processes,
            told=lambda result: f"{result['cpu_s']} s {result.get('failed', '')}",
        )
        found = list(kept.values())
        if found:
            parts.append(f"### {NAMES[rig]}\n\n{summary(found, program)}\n\n{tables_of(found)}")
    return "\n\n".join(parts)


def whole(chosen: Namespace) -> bool:
    """Whether these are the tables of the document."""
    parts = (chosen.rig, chosen.seeds)
    return not (chosen.quick or any(parts))


def summary(results: Sequence[Result], program: str) -> str:
    """What the tables are made of."""
    seeds = sorted(r["seed"] for r in results)
    check_kind(seeds)
    kind = "tuning" if seeds[0] in TUNING else "judging"
    cpu = sum(r["cpu_s"] for r in results) / len(results)
    return (
        f"{len(seeds)} {kind} seeds, {seeds[0]} to {seeds[-1]}; {cpu:.1f} s of CPU each; "
        f"package {program[:12]}."
    )


def seeds_of(text: str) -> range:
    """Seeds `A:B`, B left out.

    Raises
    ------
    SystemExit
        If they are not of one kind, tuning or judging.
    """
    first, _, last = text.replace("-", ":").partition(":")
    seeds = range(int(first), int(last) if last else int(first) + 1)
    if len(seeds):
        check_kind(seeds)
    return seeds


def check_kind(seeds: Sequence[int]) -> None:
    """Refuse seeds that are not all for tuning or all for judging."""
    tuning = [seed in TUNING for seed in (min(seeds), max(seeds))]
    judging = [seed >= FIRST_JUDGING for seed in (min(seeds), max(seeds))]
    if not (all(tuning) or all(judging)):
        raise SystemExit(
            f"seeds {min(seeds)} to {max(seeds)}: give seeds below {TUNING.stop} (tuning) or from "
            f"{FIRST_JUDGING} on (judging), not both"
        )
