"""Run command lines on damaged files in one process, and say what was not answered
well.
"""

import multiprocessing
import re
import resource
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.mutations import mutated
from tests.studies.fuzz.targets import Target

WALL_S, PEAK_KIB, SLICE = 600, 1 << 20, 250
# answers of one kind, bytes of an input that is damaged further
ANSWERS, LONGEST = 2000, 200_000
_DETAIL = re.compile(r"[0-9]\S*|'[^']*'|\"[^\"]*\"|\\\S*|/\S*")
Answer = tuple[int, str]  # exit code, and the words of its message


@dataclass(frozen=True)
class Outcome:
    """What came of one input: `why` it is not well answered; CPU s, peak KiB of the
    process.
    """

    why: str
    answer: Answer = (-1, "")
    line: Sequence[str] = ()
    said: str = ""
    damage: str = ""
    seconds: float = 0.0
    peak: int = 0
    data: bytes = b""


@dataclass
class Tally:
    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def finds(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if outcome.why]

    @property
    def codes(self) -> Counter[int]:
        return Counter(outcome.answer[0] for outcome in self.outcomes)

    @property
    def answers(self) -> set[Answer]:
        return {outcome.answer for outcome in self.outcomes}

    @property
    def fresh(self) -> list[bytes]:
        return [
            o.data for o in self.outcomes if not o.why and 0 < len(o.data) < LONGEST
        ]


def fuzz(target: Target, folder: Path, count: int, seed: int, tally: Tally) -> None:
    """Try `count` inputs more, in a process of their own for each slice."""
    lay_out(target, folder)
    for start in range(0, count, SLICE):
        size = min(SLICE, count - start)
        tally.outcomes += _in_child(target, folder, size, (seed, start), tally)


def lay_out(target: Target, folder: Path) -> None:
    for name, content in target.beside.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / target.file).parent.mkdir(exist_ok=True)


def filled(line: Sequence[str], target: Target, folder: Path) -> list[str]:
    words = [word.replace("{}", str(folder / target.file)) for word in line]
    return [word.replace("{@}", str(folder)) for word in words]


def _in_child(target: Target, folder: Path, *job: Any) -> list[Outcome]:
    """Return what `_slice` says; of a silent process, the input that it had last.

    A fork of the caller would start with the caller's memory, and a slice would answer
    for what it did not allocate: a server that holds nothing but this module is forked
    instead.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])

    mine, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_slice, args=(theirs, target, folder, *job))
    process.start()
    theirs.close()
    try:
        if mine.poll(WALL_S):
            outcomes: list[Outcome] = mine.recv()
            return outcomes
        why = "stands still"
    except EOFError:
        why = "process died"
    finally:
        process.kill()
        process.join()
    data = (folder / target.file).read_bytes()
    return [Outcome(f"{why} ({process.exitcode})", data=data)]


def _slice(
    sender: Connection,
    target: Target,
    folder: Path,
    count: int,
    seed: Sequence[int],
    known: Tally,
) -> None:
    rng, answers, fresh = np.random.default_rng(seed), known.answers, known.fresh
    outcomes: list[Outcome] = []
    while len(outcomes) < count:
        pool = fresh if fresh and rng.random() < 0.4 else target.seeds
        data, damage = mutated(pool[int(rng.integers(len(pool)))], target.damages, rng)
        line = target.lines[int(rng.integers(len(target.lines)))]
        (folder / target.file).write_bytes(data)
        outcome = _one(folder, filled(line, target, folder))
        unheard = outcome.answer not in answers and len(answers) < ANSWERS
        kept = data if outcome.why or unheard else b""
        outcomes.append(replace(outcome, line=tuple(line), damage=damage, data=kept))
        if unheard:
            answers.add(outcome.answer)
        if outcome.peak > PEAK_KIB:  # of the whole process: another takes the rest
            break
    sender.send(outcomes)
    sender.close()


def _one(folder: Path, line: Sequence[str]) -> Outcome:
    begun = time.process_time()
    code, said, why = answer(line)
    spent = time.process_time() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if peak > PEAK_KIB:
        why = why or f"memory: {peak >> 10} MiB"
    if any(folder.glob(".*.tmp")):
        why = why or "litter"
    for path in folder.glob("out.*"):
        path.unlink()
    key = (code, _DETAIL.sub("#", said.split("error: ")[-1])[:200])
    return Outcome(why, key, said=said[-3000:] if why else "", seconds=spent, peak=peak)
