"""Run the studies: `python -m tests.study [--quick] [--only NAME ...]`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tests.study import formats, one_joint, recorded, six_joint, two_joint
from tests.study.tables import placed

README = Path(__file__).parents[2] / "README.md"

Study = Callable[[bool], str]
STUDIES: Mapping[str, Study] = {
    "one_joint": lambda quick: one_joint.study(1 if quick else 8),
    "two_joint": lambda quick: two_joint.study(1 if quick else 6),
    "six_joint": lambda quick: "" if quick else six_joint.study(3),
    "recorded": lambda quick: recorded.study(),
    "formats": lambda quick: formats.study(6 if quick else 12),
}


def main(arguments: Sequence[str]) -> int:
    """Print the tables; a full run also puts them into the README."""
    parser = argparse.ArgumentParser(prog="python -m tests.study", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one rig each; README stays")
    parser.add_argument("--only", nargs="+", choices=list(STUDIES), default=list(STUDIES))
    chosen = parser.parse_args(arguments)
    if not chosen.quick:
        for name in chosen.only:  # a missing marker shows before the work is done
            placed(README.read_text(encoding="utf-8"), name, "")
    for name in chosen.only:
        start = time.monotonic()
        content = STUDIES[name](chosen.quick)
        sys.stdout.write(f"## {name}\n\n{content or 'left out by --quick'}\n\n")
        sys.stdout.flush()
        sys.stderr.write(f"{name}: {time.monotonic() - start:.0f} s\n")
        if not chosen.quick:
            text = README.read_text(encoding="utf-8")
            README.write_text(placed(text, name, content), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
