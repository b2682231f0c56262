"""Run command lines on damaged files, each in a child, and say what was not answered
well.

A server imports the program once and forks children. A child damages a file and runs a
command line on it; one that reads files without a command takes some after each other.
It may die: what the server sees then is a find, and the next input gets another child.
"""

import contextlib
import gc
import importlib
import multiprocessing
import os
import re
import resource
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
from typing import IO, NoReturn

import numpy as np

from seqid_cli.__main__ import main
from tests.studies.fuzz.answers import CPU_S, answer
from tests.studies.fuzz.claims import broken
from tests.studies.fuzz.mutations import mutated
from tests.studies.fuzz.readers import READERS, read_alone
from tests.studies.fuzz.target import Line, Target

# How long a child may stand still, which takes no CPU time [s].
WALL_S = 300.0
PEAK_KIB = 1 << 20
# Inputs of a server. It imports anew what readers need, which takes it a second.
SLICE = 1000
# Inputs that a child reads one after the other; a command gets a child of its own.
OF_A_CHILD = 25
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


@dataclass(frozen=True)
class Known:
    """Answers that inputs got, and inputs that got one of their own."""

    answers: set[Answer]
    fresh: list[bytes]

    def is_new(self, answer: Answer) -> bool:
        return answer not in self.answers and len(self.answers) < ANSWERS

    def learn(self, outcome: Outcome) -> None:
        if not self.is_new(outcome.answer):
            return
        self.answers.add(outcome.answer)
        if not outcome.why and 0 < len(outcome.data) < LONGEST:
            self.fresh.append(outcome.data)


def _of_server(
    target: Target, folder: Path, count: int, seed: Sequence[int], tally: Tally
) -> Iterator[Outcome]:
    """Yield what a server says of each input.

    A fork of the caller would start with the caller's memory, and an input would answer
    for what it did not allocate: a process that holds nothing but this module is forked
    instead.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])

    mine, theirs = context.Pipe(duplex=False)
    known = Known(tally.answers, tally.fresh)
    process = context.Process(
        target=_serve, args=(theirs, target, folder, count, seed, known)
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
    known: Known,
) -> None:
    # As the program does before it imports Arrow.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    is_alone = all(line[0] in READERS for line in target.lines)
    most = OF_A_CHILD if is_alone else 1
    done = 0
    with tempfile.TemporaryFile() as heard:
        # What libraries write past Python.
        os.dup2(heard.fileno(), 2)
        while done < count:
            numbers = range(done, min(done + most, count))
            draws = Draws(target, folder, seed, known, heard)
            for outcome in _of_child(draws, numbers):
                _import(outcome.imported)
                known.learn(outcome)
                sender.send(replace(outcome, imported=()))
                done += 1
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


@dataclass(frozen=True)
class Draws:
    """Inputs by their numbers: what is damaged, how, and who reads it."""

    target: Target
    folder: Path
    seed: Sequence[int]
    known: Known
    heard: IO[bytes]

    @property
    def path(self) -> Path:
        return self.folder / self.target.file

    def draw(self, number: int) -> tuple[np.random.Generator, bytes, Line]:
        """Draw a sound file and a command line, from what is known by now."""
        rng = np.random.default_rng((*self.seed, number))
        fresh = self.known.fresh
        pool = fresh if fresh and rng.random() < 0.4 else self.target.seeds
        sound = pool[int(rng.integers(len(pool)))]
        line = self.target.lines[int(rng.integers(len(self.target.lines)))]
        return rng, sound, line

    def tried(self, number: int) -> Outcome:
        """Damage a file and run a command line on it.

        The file is damaged by libraries too, which a file that is damaged already may
        end.
        """
        self.path.unlink(missing_ok=True)
        rng, sound, line = self.draw(number)
        words = filled(line, self.target, self.folder)
        patience = PATIENCE_S.get(words[0], CPU_S)
        _limit(patience)
        before = len(sys.modules)

        data, damage = mutated(sound, self.target.damages, rng)
        self.path.write_bytes(data)
        del data
        # The peak begins anew: damaging a file is not what is measured.
        Path("/proc/self/clear_refs").write_text("5")
        outcome = _one(self.folder, words, patience)
        peak = _peak_kib()
        # A look at the names of all modules would copy the pages in which they lie.
        later = max(len(sys.modules) - before, 0)
        imported = tuple(reversed(tuple(islice(reversed(sys.modules), later))))
        why = outcome.why
        if peak > PEAK_KIB:
            why = why or f"memory: {peak >> 10} MiB"
        outcome = replace(
            outcome, why=why, line=line, damage=damage, peak=peak, imported=imported
        )
        return self.ended(outcome)

    def ended(self, outcome: Outcome) -> Outcome:
        """Add the input and what libraries have said, and clear up."""
        if self.heard.seek(0, os.SEEK_END):
            self.heard.seek(0)
            said = self.heard.read(2000).decode(errors="replace")
            self.heard.seek(0)
            self.heard.truncate(0)
            why = outcome.why or "a library writes to the screen"
            outcome = replace(outcome, why=why, said=outcome.said + said)
        if self.path.is_file() and (outcome.why or self.known.is_new(outcome.answer)):
            outcome = replace(outcome, data=self.path.read_bytes())
        _clear(self.folder)
        return outcome


def _peak_kib() -> int:
    """Return the most memory that this process held since its peak began anew."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0])


def _of_child(draws: Draws, numbers: Sequence[int]) -> Iterator[Outcome]:
    """Try inputs one after the other in a child that may die.

    What is not well answered is the last of its child: it may have left something
    behind. The inputs that follow get another one.
    """
    mine, theirs = multiprocessing.Pipe(duplex=False)
    child = os.fork()
    if not child:
        mine.close()
        _answer_all(theirs, draws, numbers)
    theirs.close()

    ending: int | None = None  # the number of the input that ended the child
    stands_still = False
    seconds_before = 0.0
    for number in numbers:
        stands_still = not mine.poll(WALL_S)
        if stands_still:
            os.kill(child, signal.SIGKILL)
        try:
            outcome: Outcome = mine.recv()
        except EOFError:
            ending = number
            break
        yield outcome
        seconds_before += outcome.seconds
        if outcome.why:
            break
    mine.close()
    _, status, used = os.wait4(child, 0)
    if ending is None:
        return

    why = f"the process died ({os.waitstatus_to_exitcode(status)})"
    answer = (-1, "")
    if stands_still:
        why = "stands still"
    elif not draws.path.is_file():
        why, answer = "", (-1, "a library that damages files has died")
    _, _, line = draws.draw(ending)
    ended = Outcome(
        why=why,
        answer=answer,
        line=line,
        seconds=used.ru_utime + used.ru_stime - seconds_before,
        peak=used.ru_maxrss,
    )
    yield draws.ended(ended)


def _answer_all(sender: Connection, draws: Draws, numbers: Sequence[int]) -> NoReturn:
    """Send what came of inputs, one by one; the process ends here."""
    try:
        for number in numbers:
            outcome = draws.tried(number)
            draws.known.learn(outcome)
            sender.send(outcome)
            if outcome.why:
                break
    except BaseException:
        os._exit(1)
    os._exit(0)


def _limit(patience: float) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE))
    # A signal's handler in Python waits until a library comes back; the kernel does
    # not. Claims of a result are held against a second command.
    seconds = int(time.process_time() + 2.0 * patience) + GRACE_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
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
