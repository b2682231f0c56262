"""Run command lines on damaged files, each in a child, and say what was not answered
well.

A server imports the program once and forks a child for each input. The child damages a
file and runs a command line on it. It may die: what the server sees then is a find, and
the next input gets a child of its own.
"""

import contextlib
import gc
import importlib
import multiprocessing
import os
import pickle
import re
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from seqid_cli.__main__ import main
from tests.studies.fuzz.answers import CPU_S, answer
from tests.studies.fuzz.claims import broken
from tests.studies.fuzz.mutations import mutated
from tests.studies.fuzz.readers import READERS, read_alone
from tests.studies.fuzz.target import Target

# How long a child may stand still, which takes no CPU time [s].
WALL_S = 300.0
PEAK_KIB = 1 << 20
# Inputs of a server. It imports anew what readers need, which takes it a second.
SLICE = 1000
# Address space of a child: what asks for more than this dies or says so.
SPACE = 4 << 30
# Seconds beyond what a command may take, after which the kernel ends a child that
# does not come back from a library.
GRACE_S = 5
# answers of one kind, bytes of an input that is damaged further
ANSWERS, LONGEST = 2000, 200_000
# CPU seconds of commands that search, of which sound files take some ten.
PATIENCE_S = {"plan": 60.0, "run": 60.0, "refine": 60.0}
_DETAIL = re.compile(r"[0-9]\S*|'[^']*'|\"[^\"]*\"|\\\S*|/\S*")
Answer = tuple[int, str]  # exit code, and the words of its message


@dataclass(frozen=True)
class Outcome:
    """What came of one input.

    `why` says why it is not well answered, if it is not; `seconds` are of the CPU,
    `peak` is that of the child [KiB]. `imported` are modules that the child had to
    import.
    """

    why: str
    answer: Answer = (-1, "")
    line: Sequence[str] = ()
    said: str = ""
    damage: str = ""
    seconds: float = 0.0
    peak: int = 0
    data: bytes = b""
    imported: Sequence[str] = ()


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
    """Try `count` inputs more, with a server of their own for each slice."""
    lay_out(target, folder)
    for done in range(0, count, SLICE):
        size = min(SLICE, count - done)
        tally.outcomes += _of_server(target, folder, size, (seed, done), tally)


def lay_out(target: Target, folder: Path) -> None:
    for name, content in {**target.beside, target.file: b""}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def filled(line: Sequence[str], target: Target, folder: Path) -> list[str]:
    words = [word.replace("{}", str(folder / target.file)) for word in line]
    return [word.replace("{@}", str(folder)) for word in words]


def _of_server(
    target: Target, folder: Path, count: int, seed: Sequence[int], known: Tally
) -> Iterator[Outcome]:
    """Yield what a server says of each input.

    A fork of the caller would start with the caller's memory, and an input would answer
    for what it did not allocate: a process that holds nothing but this module is forked
    instead.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])

    mine, theirs = context.Pipe(duplex=False)
    begun = known.answers, known.fresh
    process = context.Process(
        target=_serve, args=(theirs, target, folder, count, seed, *begun)
    )
    process.start()
    theirs.close()
    try:
        for _ in range(count):
            yield mine.recv()
    finally:
        process.kill()
        process.join()


def _serve(
    sender: Connection,
    target: Target,
    folder: Path,
    count: int,
    seed: Sequence[int],
    answers: set[Answer],
    fresh: list[bytes],
) -> None:
    # As the program does before it imports Arrow.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    with tempfile.TemporaryFile() as heard:
        # What libraries write past Python.
        os.dup2(heard.fileno(), 2)
        for number in range(count):
            rng = np.random.default_rng((*seed, number))
            pool = fresh if fresh and rng.random() < 0.4 else target.seeds
            sound = pool[int(rng.integers(len(pool)))]
            line = target.lines[int(rng.integers(len(target.lines)))]
            outcome = _in_child(target, folder, sound, line, rng)

            _import(outcome.imported)
            if heard.seek(0, os.SEEK_END):
                heard.seek(0)
                said = heard.read(2000).decode(errors="replace")
                heard.seek(0)
                heard.truncate(0)
                why = outcome.why or "a library writes to the screen"
                outcome = replace(outcome, why=why, said=outcome.said + said)
            unheard = outcome.answer not in answers and len(answers) < ANSWERS
            path = folder / target.file
            is_kept = path.is_file() and (bool(outcome.why) or unheard)
            data = path.read_bytes() if is_kept else b""
            sender.send(replace(outcome, line=line, data=data, imported=()))
            if unheard:
                answers.add(outcome.answer)
                if not outcome.why and 0 < len(data) < LONGEST:
                    fresh.append(data)
            _clear(folder)
    sender.close()


def _import(names: Sequence[str]) -> None:
    """Import what a child had to import, for all that follow."""
    for name in names:
        # A module may have been made by the file that the child has read.
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    if names:
        # A collection in a child would write to, and so copy, all that is here.
        gc.collect()
        gc.freeze()


def _in_child(
    target: Target,
    folder: Path,
    sound: bytes,
    line: Sequence[str],
    rng: np.random.Generator,
) -> Outcome:
    """Damage a sound file and run a command line on it, in a child that may die.

    The file is damaged by libraries too, which a file that is damaged already may end.
    """
    path = folder / target.file
    path.unlink(missing_ok=True)
    words = filled(line, target, folder)
    patience = PATIENCE_S.get(words[0], CPU_S)

    read, write = os.pipe()
    child = os.fork()
    if not child:
        _limit(patience)
        before = len(sys.modules)
        data, damage = mutated(sound, target.damages, rng)
        path.write_bytes(data)
        outcome = _one(folder, words, patience)
        # A look at the names of all modules would copy the pages in which they lie.
        later = max(len(sys.modules) - before, 0)
        imported = tuple(reversed(tuple(islice(reversed(sys.modules), later))))
        with os.fdopen(write, "wb") as sender:
            pickle.dump(replace(outcome, damage=damage, imported=imported), sender)
        os._exit(0)
    os.close(write)

    is_told, _, _ = select.select([read], [], [], WALL_S)
    if not is_told:
        os.kill(child, signal.SIGKILL)
    with os.fdopen(read, "rb") as told:
        content = told.read()
    _, status, used = os.wait4(child, 0)
    peak = used.ru_maxrss
    if not is_told:
        return Outcome("stands still", peak=peak)
    if status or not content:
        if not path.is_file():
            return Outcome("", (-1, "a library that damages files has died"))
        code = os.waitstatus_to_exitcode(status)
        spent = used.ru_utime + used.ru_stime
        return Outcome(f"the process died ({code})", seconds=spent, peak=peak)
    outcome: Outcome = pickle.loads(content)
    why = outcome.why
    if peak > PEAK_KIB:
        why = why or f"memory: {peak >> 10} MiB"
    return replace(outcome, why=why, peak=peak)


def _limit(patience: float) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE))
    # A signal's handler in Python waits until a library comes back; the kernel does
    # not. Claims of a result are held against a second command.
    seconds = int(2.0 * patience) + GRACE_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _one(folder: Path, line: Sequence[str], patience: float) -> Outcome:
    begun = time.process_time()
    program = read_alone if line[0] in READERS else main
    code, said, why = answer(line, patience, program)
    spent = time.process_time() - begun
    # A library may swallow what its caller is stopped by.
    if spent > patience:
        why = why or f"took {spent:.1f} s"
    if any(folder.glob(".*.tmp")):
        why = why or "litter"
    if not why and code in (0, 1, 3):
        why = broken(line, folder)
    key = (code, _DETAIL.sub("#", said.split("error: ")[-1])[:200])
    return Outcome(why, key, said=said[-3000:] if why else "", seconds=spent)


def _clear(folder: Path) -> None:
    """Remove what a command has written, and what a killed one left."""
    for path in (*folder.glob("out*"), *folder.glob(".*.tmp")):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
