"""CPU time of a command by the steps of a search: `python -m tests.studies.steps refine
LOG ...`, with the words of a command of seqid.

Steps lie in each other, so that their times overlap.
"""

import functools
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

from seqid_cli.__main__ import main as run
from seqid_cli.discover import candidates, investigate
from seqid_cli.discover.refinement import confirm, loop, rounds
from seqid_cli.discover.select import linear, model, search, selection

# The names that a caller knows a step by: where it is imported, and what it is called.
STEPS: tuple[tuple[Any, tuple[str, ...]], ...] = (
    (investigate, ("select", "select_among", "noise_floor")),
    (rounds, ("investigate", "investigate_beside")),
    (loop, ("refitted",)),
    (confirm, ("confirm",)),
    (search, ("candidates_of",)),
    (model, ("candidates_of",)),
    (selection.Selection, ("run", "told")),
    (search.Search, ("everywhere", "near")),
    (model.Model, ("settle", "polish")),
    (candidates.CandidateColumns, ("_compute",)),
    (linear.LinearModel, ("fits", "scores")),
)


class Clock:
    """CPU seconds and calls of steps; of a step in itself the outer one counts."""

    def __init__(self) -> None:
        self.seconds = defaultdict[str, float](float)
        self.calls = Counter[str]()
        self._open: list[str] = []

    def timed(self, step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does the same and is timed as a step."""

        @functools.wraps(function)
        def call(*arguments: Any, **keywords: Any) -> Any:
            start_s = time.process_time()
            self._open.append(step)
            try:
                result = function(*arguments, **keywords)
                # A generator works where it is used up.
                return iter(list(result)) if step == "candidates_of" else result
            finally:
                self._open.pop()
                self.calls[step] += 1
                if step not in self._open:
                    self.seconds[step] += time.process_time() - start_s

        return call


def main() -> int:
    clock = Clock()
    for place, names in STEPS:
        for name in names:
            setattr(place, name, clock.timed(name, getattr(place, name)))
    code = run()
    total = time.process_time()
    longest_first = sorted(clock.seconds.items(), key=lambda pair: -pair[1])
    lines = [
        f"{100.0 * seconds / total:5.1f} % {clock.calls[step]:6d} {step}"
        for step, seconds in longest_first
    ]
    sys.stderr.write("\n".join([f"{total:.1f} CPU s", *lines, ""]))
    return code or 0


if __name__ == "__main__":
    sys.exit(main())
