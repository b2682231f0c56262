"""Run cases: `python -m tests.outside --set tuning --seeds A:B [--kind KIND]`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from seqid_cli.shares import percent
from tests.outside.cases import KINDS_OF_CASE, RESERVED, as_row, kind_of, run_case
from tests.study.tables import placed

DOCUMENT = Path(__file__).parents[2] / "docs" / "outside.md"
CACHE = Path("out") / "outside.jsonl"

Row = Mapping[str, object]


def main(arguments: Sequence[str]) -> int:
    """Run what the cache does not hold, then write the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.outside", description=__doc__)
    parser.add_argument("--set", choices=("tuning", "reserved"), default="tuning")
    parser.add_argument("--seeds", default="0:32", metavar="A:B")
    parser.add_argument("--kind", choices=KINDS_OF_CASE, help="this kind at every seed")
    parser.add_argument("--cache", type=Path, default=CACHE)
    chosen = parser.parse_args(arguments)
    first, _, last = chosen.seeds.partition(":")
    seeds = range(int(first), int(last))
    if any((seed >= RESERVED) != (chosen.set == "reserved") for seed in seeds):
        parser.error(f"tuning seeds are below {RESERVED}, reserved ones are not")
    wanted = [(seed, chosen.kind or kind_of(seed)) for seed in seeds]
    known = {(row["seed"], row["kind"]): row for row in _rows(chosen.cache)}
    chosen.cache.parent.mkdir(parents=True, exist_ok=True)
    for seed, kind in wanted:
        if (seed, kind) not in known:
            row = as_row(run_case(seed, kind))
            known[seed, kind] = row
            with chosen.cache.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            sys.stderr.write(f"{seed} {kind}: {row['verdict']} {row['names']} {row['error']}\n")
    rows = [row for (seed, _), row in known.items() if isinstance(seed, int)]
    own = [row for row in rows if (int(str(row["seed"])) >= RESERVED) == (chosen.set == "reserved")]
    table = tabulated(own)
    sys.stdout.write(table + "\n")
    if chosen.set == "tuning":
        text = DOCUMENT.read_text(encoding="utf-8")
        DOCUMENT.write_text(placed(text, "outside", table), encoding="utf-8")
    return 0


def _rows(cache: Path) -> list[Row]:
    if not cache.exists():
        return []
    return [json.loads(line) for line in cache.read_text(encoding="utf-8").splitlines()]


def tabulated(rows: Iterable[Row]) -> str:
    """Markdown: a line per kind, with the shares of right answers."""
    lines = [
        "| kind | cases | effect found | right name or one it is not told from | right name "
        "| right joint | stages good | failed |",
        "|---|---|---|---|---|---|---|---|",
    ]
    every = list(rows)
    for kind in KINDS_OF_CASE:
        own = [row for row in every if row["kind"] == kind]
        if not own:
            continue

        def share(test: list[bool]) -> str:
            return percent(sum(test) / len(test), 0)

        cells = [
            share([row["verdict"] == "effect_found" for row in own]),
            share([bool(row["named"]) for row in own]),
            share([bool(row["exact"]) for row in own]),
            "-" if kind == "clean" else share([bool(row["placed"]) for row in own]),
            share([row["stages"] == "good" for row in own]),
            str(sum(row["verdict"] == "failed" for row in own)),
        ]
        lines.append(f"| {kind} | {len(own)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
