"""What +-30 % of the numbers of discovery does: `python -m
tests.studies.outside.numbers`.

Every case is recorded and identified once, and diagnosed again with each number
changed.
"""

import argparse
import importlib
import inspect
import re
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.errors import SeqidWarning
from seqid_cli.logs.read import read_recording
from seqid_cli.params.io import read_parameters
from seqid_cli.robot.file import load_robot
from seqid_cli.settings import entries, overridden
from tests import ROOT
from tests.studies.outside.cases import prepared, told
from tests.studies.outside.plan import drawn
from tests.studies.outside.questions import LOUD
from tests.studies.outside.score import label, surely_wrong
from tests.studies.records import results, seeds_of
from tests.studies.tables import show, table

PAGE = ROOT / "docs" / "reference" / "deciding_numbers.md"
FACTORS = (0.7, 1.3)


def numbers() -> dict[str, tuple[str, str]]:
    """Name and file of every number in the page's table of discovery that can be
    changed; the settings of discovery are in none.
    """
    part = PAGE.read_text(encoding="utf-8").split("## Discovery\n")[1].split("<!-- ")[0]
    rows = [
        line.split("|")[1:5] for line in part.splitlines() if line.startswith("| `")
    ]
    settings = {
        f"`{entry.name}`": (entry.name, "")
        for entry in entries(DiscoverSettings())
        if not entry.name.startswith("judging.")
    }
    return settings | {
        name.strip(): (name.strip().strip("`"), where.strip(" `"))
        for name, default, _, where in rows
        if re.fullmatch(r"`[\w.]+`( of `\w+`)?", name.strip()) and "," not in default
    }


@contextmanager
def changed(name: str, where: str, factor: float) -> Iterator[DiscoverSettings]:
    """Yield the settings to diagnose with, while a number of a module is changed."""
    if not where:
        defaults = {entry.name: entry.default for entry in entries(DiscoverSettings())}
        given = f"{name}={factor * defaults[name]!r}"
        yield overridden(DiscoverSettings(), [given])
        return
    module = importlib.import_module(
        f"seqid_cli.{where.removesuffix('.py').replace('/', '.')}"
    )
    undo = list[tuple[Any, str, Any]]()

    def put(owner: Any, key: str, value: Any) -> None:
        undo.append((owner, key, getattr(owner, key)))
        setattr(owner, key, value)

    try:
        if " of " in name:
            argument, owner = name.replace("`", "").split(" of ")
            places = [module, *(x for x in vars(module).values() if inspect.isclass(x))]
            function = next(
                vars(x)[owner] for x in places if callable(vars(x).get(owner))
            )
            known = function.__kwdefaults__
            put(
                function, "__kwdefaults__", known | {argument: known[argument] * factor}
            )
        elif name.startswith("Options."):
            key = name.removeprefix("Options.")
            value = getattr(Options, key)
            put(Options, key, value * factor)
            place = [field.name for field in fields(Options)].index(key)
            of_init = list(Options.__init__.__defaults__)  # type: ignore[arg-type]
            of_init[place] = value * factor
            put(Options.__init__, "__defaults__", tuple(of_init))
        else:
            value = getattr(module, name)
            own = [x for key, x in sys.modules.items() if key.startswith("seqid_cli")]
            for place in (x for x in own if vars(x).get(name) == value):
                put(place, name, value * factor)
        yield DiscoverSettings()
    finally:
        for owner, key, value in reversed(undo):
            setattr(owner, key, value)


def answered(seed: int) -> dict[str, Any]:
    """Names of what is told, by the number that was changed, and by how much."""
    case, rows = drawn(seed), dict[str, Any]()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        ready = prepared(case, Path(folder))
        robot = load_robot(ready.recorder.robot)
        logs = [read_recording(path, robot) for path in ready.logs]
        stages = read_parameters(ready.file).stages
        options = DiscoverOptions()
        # one motion for all of them
        filtering = replace(options.motion.motion, kept={})
        options = replace(options, motion=replace(options.motion, motion=filtering))

        def row(settings: DiscoverSettings) -> dict[str, Any]:
            chosen = replace(options, settings=settings)
            found = told(diagnose(logs, robot, stages, options=chosen))
            hidden = {
                "kinds": [x.name for x in case.effects],
                "flow": case.outline.flow,
            }
            whole = (
                found
                | hidden
                | {
                    "joints": [" ".join(x) for x in case.joints],
                    "error": "",
                }
            )
            labels = [label(whole, i) for i in range(len(case.effects))]
            names = sorted(f"{x['effect']} {x['joint']}" for x in found["findings"])
            right = sum(x in ("right", "alike") for x in labels)
            return {"names": names, "right": right, "wrong": surely_wrong(whole, LOUD)}

        rows["as it is"] = row(DiscoverSettings())
        for title, (name, where) in numbers().items():
            for factor in FACTORS:
                with changed(name, where, factor) as settings:
                    rows[f"{title} x {factor}"] = row(settings)
    return {"seed": seed, "rows": rows}


def tabulated(kept: Sequence[dict[str, Any]]) -> str:
    """For each number: cases with other names, effects named right, cases with a wrong
    name.
    """
    every = [one["rows"] for one in kept]
    usual = [rows["as it is"] for rows in every]
    right, wrong = (sum(row[key] for row in usual) for key in ("right", "wrong"))

    def cells(title: str) -> list[str]:
        rows = [one[title] for one in every]
        others = sum(a["names"] != b["names"] for a, b in zip(rows, usual, strict=True))
        more = [sum(row[key] for row in rows) for key in ("right", "wrong")]
        return [str(others), f"{more[0] - right:+d}", f"{more[1] - wrong:+d}"]

    lines = []
    for title in numbers():
        if all(f"{title} x {factor}" in every[0] for factor in FACTORS):
            less, more = (cells(f"{title} x {factor}") for factor in FACTORS)
            lines.append([title, *less, *more])
    head = ["number", "-30 %: other names", "right", "wrong", "+30 %: other names"]
    first = (
        f"{len(every)} cases, {right} effects named right, a wrong name above 0.8 in"
        f" {wrong}."
    )
    return first + "\n\n" + table([*head, "right ", "wrong "], lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.outside.numbers")
    parser.add_argument("--seeds", type=seeds_of, default="1000:1200", metavar="A:B")
    parser.add_argument("--cache", type=Path, default=Path("out") / "outside")
    parser.add_argument(
        "--write", action="store_true", help="write the table into the document"
    )
    chosen = parser.parse_args()
    cases = {str(seed): seed for seed in chosen.seeds}
    kept = results(
        cases, answered, dict[str, Any], chosen.cache / "numbers.jsonl", processes=2
    )
    show(
        f"reference/{PAGE.name}",
        "numbers",
        tabulated(list(kept.values())),
        kept=chosen.write,
    )


if __name__ == "__main__":
    main()
