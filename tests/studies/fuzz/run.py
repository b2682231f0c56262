"""Run command lines on damaged files in one process, and say what was not answered well."""

from __future__ import annotations

import multiprocessing
import re
import resource
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.mutations import mutated
from tests.studies.fuzz.targets import Target

WALL_S, PEAK_KIB, SLICE = 600, 1 << 20, 250
_DETAIL = re.compile(r"[0-9]\S*|'[^']*'|\"[^\"]*\"|\\\S*|/\S*")


@dataclass(frozen=True)
class Find:
    """An input that was not answered well: why, on which command line, and its bytes."""

    why: str
    line: tuple[str, ...]
    said: str
    data: bytes
    damage: str


@dataclass
class Tally:
    """What came of the inputs of one target; `slowest` s of CPU, `peak` KiB of the process."""

    codes: Counter[int] = field(default_factory=Counter)
    finds: list[Find] = field(default_factory=list)
    slowest: float = 0.0
    peak: int = 0
    cpu: float = 0.0
    answers: set[tuple[int, str]] = field(default_factory=set)
    fresh: list[bytes] = field(default_factory=list)  # inputs with an answer that none had before

    def take(self, part: Tally) -> None:
        """Add what a slice found."""
        self.codes += part.codes
        self.finds += part.finds
        self.slowest = max(self.slowest, part.slowest)
        self.peak = max(self.peak, part.peak)
        self.cpu += part.cpu
        self.answers |= part.answers
        self.fresh += part.fresh


def fuzz(target: Target, folder: Path, count: int, seed: int, tally: Tally) -> None:
    """Try `count` inputs more, in a process of their own for each slice.

    An input whose answer none before had, by its exit code and the words of its message, is
    damaged further: so the inputs get from one check of a reader to the next.
    """
    lay_out(target, folder)
    for start in range(0, count, SLICE):
        size = min(SLICE, count - start)
        tally.take(_in_child(target, folder, size, (seed, start), tally))


def lay_out(target: Target, folder: Path) -> None:
    """Write what lies beside the damaged file."""
    for name, content in target.beside.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / target.file).parent.mkdir(exist_ok=True)


def _in_child(
    target: Target, folder: Path, count: int, seed: tuple[int, int], known: Tally
) -> Tally:
    context = multiprocessing.get_context("fork")
    mine, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_slice, args=(theirs, target, folder, count, seed, known))
    process.start()
    theirs.close()
    try:
        if mine.poll(WALL_S):
            return mine.recv()  # type: ignore[no-any-return]
        why = "stands still"
    except EOFError:
        why = "process died"
    finally:
        process.kill()
        process.join()
    data = (folder / target.file).read_bytes()
    return Tally(finds=[Find(f"{why} ({process.exitcode})", (), "", data, "")])


def _slice(
    sender: Connection,
    target: Target,
    folder: Path,
    count: int,
    seed: tuple[int, int],
    known: Tally,
) -> None:
    rng, tally = np.random.default_rng(seed), Tally(answers=set(known.answers))
    for _ in range(count):
        pool = known.fresh if known.fresh and rng.random() < 0.4 else target.seeds
        data, damage = mutated(pool[int(rng.integers(len(pool)))], target.damages, rng)
        line = target.lines[int(rng.integers(len(target.lines)))]
        _one(target, folder, line, data, damage, tally)
        if tally.peak > PEAK_KIB:  # of the whole process: another takes the rest
            break
    tally.answers -= known.answers
    sender.send(tally)
    sender.close()


def filled(line: Sequence[str], target: Target, folder: Path) -> list[str]:
    """Put the damaged file and its folder into a command line."""
    words = [word.replace("{}", str(folder / target.file)) for word in line]
    return [word.replace("{@}", str(folder)) for word in words]


def _one(
    target: Target, folder: Path, line: Sequence[str], data: bytes, damage: str, tally: Tally
) -> None:
    (folder / target.file).write_bytes(data)
    arguments = filled(line, target, folder)
    begun = time.process_time()
    code, said, why = answer(arguments)
    spent = time.process_time() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if peak > PEAK_KIB:
        why = why or f"memory: {peak >> 10} MiB"
    if any(folder.glob(".*.tmp")):
        why = why or "litter"
    for path in folder.glob("out.*"):
        path.unlink()
    tally.codes[code] += 1
    tally.cpu, tally.peak = tally.cpu + spent, max(tally.peak, peak)
    tally.slowest = max(tally.slowest, spent)
    if why:
        tally.finds.append(Find(why, tuple(line), said[-3000:], data, damage))
    key = (code, _DETAIL.sub("#", said.split("error: ")[-1])[:200])
    if key not in tally.answers and len(tally.answers) < 2000:
        tally.answers.add(key)
        if len(data) < 200_000:
            tally.fresh.append(data)


def tell(text: str) -> None:
    """Say how far it is."""
    sys.stderr.write(text + "\n")
