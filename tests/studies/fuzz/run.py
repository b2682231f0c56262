"""Run command lines on damaged files in children, and say what was not answered well.

A child tells of each input before and after it: of a child that a library ends, the
input that it had last is a find, and another child goes on with the next.
"""

import multiprocessing
import os
import re
import resource
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from tests.studies.fuzz.answers import CPU_S, answer
from tests.studies.fuzz.claims import broken
from tests.studies.fuzz.mutations import mutated
from tests.studies.fuzz.targets import Target

WALL_S, PEAK_KIB, SLICE = 600, 1 << 20, 250
# Address space of a child: what more than the peak is asked for is a find as well.
SPACE = 4 << 30
# answers of one kind, bytes of an input that is damaged further
ANSWERS, LONGEST = 2000, 200_000
# CPU seconds of commands that search, of which sound files take some ten.
PATIENCE_S = {"plan": 60.0, "run": 60.0, "refine": 60.0}
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
    kept: list[bytes] = field(default_factory=list)  # of earlier runs

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
        """Inputs that got an answer of their own: they are damaged further."""
        return self.kept + [
            o.data for o in self.outcomes if not o.why and 0 < len(o.data) < LONGEST
        ]


def fuzz(target: Target, folder: Path, count: int, seed: int, tally: Tally) -> None:
    """Try `count` inputs more, in a process of their own for each slice."""
    lay_out(target, folder)
    done = 0
    while done < count:
        size = min(SLICE, count - done)
        tried = list(_in_child(target, folder, size, (seed, done), tally))
        tally.outcomes += tried
        done += max(len(tried), 1)


def lay_out(target: Target, folder: Path) -> None:
    for name, content in {**target.beside, target.file: b""}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def filled(line: Sequence[str], target: Target, folder: Path) -> list[str]:
    words = [word.replace("{}", str(folder / target.file)) for word in line]
    return [word.replace("{@}", str(folder)) for word in words]


def _in_child(
    target: Target, folder: Path, count: int, seed: Sequence[int], known: Tally
) -> Iterator[Outcome]:
    """Yield what a child says of each input; of a silent one, the input that it had.

    A fork of the caller would start with the caller's memory, and a slice would answer
    for what it did not allocate: a server that holds nothing but this module is forked
    instead.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])

    mine, theirs = context.Pipe(duplex=False)
    begun = known.answers, known.fresh
    process = context.Process(
        target=_slice, args=(theirs, target, folder, count, seed, *begun)
    )
    process.start()
    theirs.close()
    tried = Outcome("no input was tried")
    try:
        while True:
            if not mine.poll(WALL_S):
                yield replace(tried, why="stands still")
                return
            told: Outcome | None = mine.recv()
            if told is None:
                return
            if told.why != _TRYING:
                yield told
            tried = told
    except EOFError:
        process.join()
        if tried.why == _TRYING:
            yield replace(tried, why=f"the process died ({process.exitcode})")
    finally:
        process.kill()
        process.join()


_TRYING = "being tried"


def _slice(
    sender: Connection,
    target: Target,
    folder: Path,
    count: int,
    seed: Sequence[int],
    answers: set[Answer],
    fresh: list[bytes],
) -> None:
    rng = np.random.default_rng(seed)
    resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE))
    with tempfile.TemporaryFile() as heard:
        # What libraries write past Python.
        os.dup2(heard.fileno(), 2)
        for _ in range(count):
            pool = fresh if fresh and rng.random() < 0.4 else target.seeds
            sound = pool[int(rng.integers(len(pool)))]
            data, damage = mutated(sound, target.damages, rng)
            line = target.lines[int(rng.integers(len(target.lines)))]
            (folder / target.file).write_bytes(data)
            sender.send(Outcome(_TRYING, line=line, damage=damage, data=data))
            outcome = _one(folder, filled(line, target, folder))
            if heard.seek(0, 2):
                heard.seek(0)
                said = heard.read(2000).decode(errors="replace")
                heard.truncate(0)
                why = outcome.why or "a library writes to the screen"
                outcome = replace(outcome, why=why, said=outcome.said + said)
            unheard = outcome.answer not in answers and len(answers) < ANSWERS
            kept = data if outcome.why or unheard else b""
            sender.send(replace(outcome, line=line, damage=damage, data=kept))
            if unheard:
                answers.add(outcome.answer)
            if outcome.peak > PEAK_KIB:  # of the whole process: another takes the rest
                break
    sender.send(None)
    sender.close()


def _one(folder: Path, line: Sequence[str]) -> Outcome:
    begun = time.process_time()
    code, said, why = answer(line, PATIENCE_S.get(line[0], CPU_S))
    spent = time.process_time() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if peak > PEAK_KIB:
        why = why or f"memory: {peak >> 10} MiB"
    if any(folder.glob(".*.tmp")):
        why = why or "litter"
    if not why and code in (0, 1, 3):
        why = broken(line, folder)
    for path in folder.glob("out*"):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
    key = (code, _DETAIL.sub("#", said.split("error: ")[-1])[:200])
    return Outcome(why, key, said=said[-3000:] if why else "", seconds=spent, peak=peak)
