"""Measure, and write the tables: `python -m tests.benchmarks [--quick] [--only NAME ...]`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence

from tests import ROOT
from tests.benchmarks import discovery, ingestion, kernels, smoother, start, whole_run
from tests.studies.tables import placed

DOCUMENT = ROOT / "docs" / "benchmarks.md"

# Each returns Markdown; `quick` is for a look whether it runs at all.
BENCHMARKS: Mapping[str, Callable[[bool], str]] = {
    "ingestion": lambda quick: ingestion.study(quick=quick),
    "kernels": lambda quick: kernels.study(quick=quick),
    "whole_run": lambda quick: whole_run.study(quick=quick),
    "start": lambda quick: start.study(quick=quick),
    "smoother": lambda quick: smoother.study(quick=quick),
    "discovery": lambda quick: discovery.study(quick=quick),
}


def main(arguments: Sequence[str]) -> int:
    """Print the tables; a full run also puts them into the document."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small files; the document stays")
    parser.add_argument("--only", nargs="+", choices=list(BENCHMARKS), default=list(BENCHMARKS))
    chosen = parser.parse_args(arguments)
    for name in chosen.only:  # a missing marker shows before the work is done
        placed(DOCUMENT.read_text(encoding="utf-8"), name, "")
    for name in chosen.only:
        content = BENCHMARKS[name](chosen.quick)
        sys.stdout.write(f"## {name}\n\n{content}\n\n")
        sys.stdout.flush()
        if not chosen.quick:
            text = DOCUMENT.read_text(encoding="utf-8")
            DOCUMENT.write_text(placed(text, name, content), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
