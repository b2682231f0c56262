"""Do the stated errors hold?

Estimates, stated standard errors and truth over many drawn arms.
"""

from argparse import Namespace
from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from tests import Array
from tests.studies.coverage.cases import ENCODERS, NOISES, case_of
from tests.studies.coverage.score import Result, Row, score, z_of
from tests.studies.records import package_sources, results, seeds_of
from tests.studies.tables import number, rms, table

TUNING = range(1000)
FIRST_JUDGING = 10_000
SEEDS = "10000:10200"  # of the document
QUICK = "0:2"
NAMES = {"one": "One joint", "planar": "Two joints, planar", "six": "Six joints"}


def study(chosen: Namespace) -> str:
    seeds = seeds_of(chosen.seeds or (QUICK if chosen.quick else SEEDS))
    if seeds:
        kind_of(seeds)
    parts, program = [], package_sources()
    for rig in [chosen.rig] if chosen.rig else ["planar"] if chosen.quick else NAMES:
        if rig not in NAMES:
            raise SystemExit(f"coverage has no rig {rig!r}, only {', '.join(NAMES)}")
        cases = {case.label: case for case in (case_of(rig, seed) for seed in seeds)}
        path = chosen.cache / "coverage" / f"{rig}.jsonl"
        how = {
            "sources": program,
            "run": not chosen.tables,
            "processes": chosen.processes,
        }
        if found := list(
            results(cases, score, Result, path, told=_told, **how).values()
        ):
            made, cpu = (
                sorted(r["seed"] for r in found),
                np.mean([r["cpu_s"] for r in found]),
            )
            parts.append(
                f"### {NAMES[rig]}\n\n{len(made)} {kind_of(made)} seeds, {made[0]} to"
                f" {made[-1]}; {cpu:.1f} s of CPU each; package"
                f" {program[:12]}.\n\n{tables_of(found)}"
            )
    return "\n\n".join(parts)


def _told(result: Result) -> str:
    return f"{result['cpu_s']} s {result.get('failed', '')}"


def whole(chosen: Namespace) -> bool:
    return not (chosen.quick or chosen.rig or chosen.seeds)


def kind_of(seeds: Sequence[int]) -> str:
    least, most = min(seeds), max(seeds)
    if most in TUNING or least >= FIRST_JUDGING:
        return "tuning" if most in TUNING else "judging"
    raise SystemExit(
        f"seeds {least} to {most}: give seeds below {TUNING.stop} (tuning) or from "
        f"{FIRST_JUDGING} on (judging), not both"
    )


INSIDE = 1.96  # standard errors: the 95 % interval
# notes of an undecided coupling
OPEN = ("do not tell whether rotors", "neither 0 nor 1")
GROUPS = ("friction", "gravity", "inertia", "imu")
HEADER = ["seeds", "values", "rms z", "inside 95 %", "interval", "largest z", "mean z"]


class Coverage(NamedTuple):
    seeds: int
    count: int
    rms: float
    share: float
    low: float
    high: float
    largest: float
    mean: float

    def cells(self) -> list[str]:
        interval = f"{100 * self.low:.0f} to {100 * self.high:.0f}"
        share = [number(self.rms, 3), f"{100 * self.share:.1f} %", interval]
        cells = [str(self.seeds), str(self.count), *share, number(self.largest, 3)]
        return [*cells, f"{self.mean:+.2f}"]


def coverage(by_seed: Sequence[Array]) -> Coverage:
    """Summarise z by seed; values of one seed may depend on each other,
    seeds do not.
    """
    kept = [z for z in by_seed if len(z)]
    z = np.concatenate(kept)
    inside = [(np.abs(own) <= INSIDE).astype(float) for own in kept]
    share = float(np.mean(np.concatenate(inside)))
    interval, largest = wilson(share, independent(inside)), float(np.abs(z).max())
    return Coverage(
        len(kept), len(z), rms(z), share, *interval, largest, float(z.mean())
    )


def independent(by_seed: Sequence[Array]) -> float:
    """Number of independent values that have the same uncertainty of their mean."""
    values = np.concatenate(by_seed)
    mean = float(values.mean())
    off = np.array([float(np.sum(x - mean)) for x in by_seed])
    variance = float(np.sum(off**2)) / float(len(values)) ** 2
    if variance == 0.0 or len(by_seed) < 2:
        return float(len(by_seed))
    return float(np.clip(mean * (1.0 - mean) / variance, len(by_seed), len(values)))


def wilson(share: float, count: float, z: float = INSIDE) -> tuple[float, float]:
    middle = share + z**2 / (2 * count)
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    scale = 1 + z**2 / count
    return float((middle - half) / scale), float((middle + half) / scale)


def tables_of(results: Sequence[Result]) -> str:
    makers = (group_table, parameter_table, coupling_table, problems)
    return "\n\n".join(filter(None, (make(results) for make in makers)))


def _errors(results: Sequence[Result], **of: str) -> list[Array]:
    """Errors over stated ones of a quantity or a group of them, seed by seed."""
    return [z_of([x for x in r["rows"] if x.items() >= of.items()]) for r in results]


def group_table(results: Sequence[Result]) -> str:
    subsets: dict[str, Sequence[Result]] = {"all": results}
    for value, trait in [*product(NOISES, ["noise"]), *product(ENCODERS, ["encoder"])]:
        some = [r for r in results if r[trait] == value]
        if 0 < len(some) < len(results):
            subsets[f"{value} {trait}"] = some
    rows = []
    for group, (label, own) in product(GROUPS, subsets.items()):
        z = _errors(own, group=group)
        if any(map(len, z)):
            rows.append([f"{group}, {label}", *coverage(z).cells()])
        good = [x for x, r in zip(z, own, strict=True) if r["verdicts"].get(group)]
        if label == "all" and 0 < len(good) < len(own):
            rows.append([f"{group}, verdict good", *coverage(good).cells()])
    return table(["group", *HEADER], rows)


def parameter_table(results: Sequence[Result]) -> str:
    """One row per parameter, joint's surface or IMU's axis."""
    every, rows = defaultdict[tuple[str, str], list[Row]](list), []
    for x in (x for r in results for x in r["rows"]):
        every[x["group"], x["name"]].append(x)
    for group, name in sorted(every, key=lambda one: GROUPS.index(one[0])):
        cells = coverage(_errors(results, group=group, name=name)).cells()
        rows.append([f"{group}: {name}", *cells, relative(every[group, name])])
    return table(["quantity", *HEADER, "median error"], rows)


def relative(rows: Sequence[Row]) -> str:
    """Median error as a share of the median truth; of mountings, deg."""
    off = np.abs([x["estimate"] - x["truth"] for x in rows])
    truth = np.abs([x["truth"] for x in rows])
    if not truth.any():
        return f"{number(float(np.median(off)))} deg"
    share = 100 * float(np.median(off) / np.median(truth))
    return f"{number(share)} %" if share < 100 else "> 100 %"


def coupling_table(results: Sequence[Result]) -> str:
    """What was decided about the coupling of the rotors, or that the stage left it
    open.
    """
    if not any("rotor_coupling" in r["traits"] for r in results):
        return ""
    found = Counter[tuple[bool, str]]()
    for result in (r for r in results if "rotor_coupling" in r):
        doubtful = any(words in note for note in result["notes"] for words in OPEN)
        decision = "left open" if doubtful else str(result["rotor_coupling"])
        found[result["traits"]["rotor_coupling"], decision] += 1
    decided = sorted({decision for _, decision in found})
    names = {False: "rotors not coupled", True: "rotors coupled"}
    rows = [
        [name, *(str(found[truth, x]) for x in decided)]
        for truth, name in names.items()
    ]
    return table(["truth; decided:", *decided], rows)


def problems(results: Sequence[Result]) -> str:
    lines = [f"- seed {r['seed']}: {r['failed']}" for r in results if "failed" in r]
    for stage in GROUPS:
        poor = [str(r["seed"]) for r in results if r["verdicts"].get(stage) is False]
        if poor:
            lines.append(f"- {stage} poor: seeds {', '.join(poor)}")
    return "\n".join(lines)
