"""Kill every writing command while it writes, and fill its disk: `python -m
tests.studies.kills`.

Whenever a tormented command begins to write a file, it is forked: each fork goes on
from there and gets SIGKILL or SIGINT at a random call or return of the writing, or may
write so many bytes only. After each the old file or the new one must be there, whole.
In the end the first process writes, and nothing else may lie in the folder.
"""

import argparse
import math
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from unittest import mock

from seqid_cli.errors import EXIT_INTERRUPTED
from seqid_cli.params import files
from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.sound import sound_commands
from tests.studies.tables import show, table

# Calls and returns after a file has its name, in which it may be killed as well.
AFTER = 2
OLD = b"what was there before\n"
SIGNALS = (signal.SIGKILL, signal.SIGINT)
# Limits of a disk that are tried, of the bytes of each file.
POINTS = 10
PATIENCE_S = 600.0
HEADER = (
    "command",
    "files",
    "kills",
    "died while writing",
    "disks too small",
    "wrong",
)


@dataclass
class Forks:
    """How many there shall be of each file, and what came of them.

    `kills` and `points` are of each file that is written. `inside` were killed when a
    temporary file was there, or interrupted before the command was done; `wrong` is
    what must not be.
    """

    kills: int
    points: int
    rng: random.Random = field(default_factory=lambda: random.Random(0))
    killed: int = 0
    inside: int = 0
    too_small: int = 0
    wrong: list[str] = field(default_factory=list)

    def of(self, target: Path) -> bool:
        """Fork before a file is written; returns True in a fork."""
        target.write_bytes(OLD)
        read, write = os.pipe()
        child = os.fork()
        if not child:
            _count_events(write, target)
            return True
        os.close(write)
        with os.fdopen(read) as told:
            first, last = map(int, told.read().split())
        os.waitpid(child, 0)
        # Some files are written again and again, each time with more in them.
        whole = target.read_bytes()
        target.write_bytes(OLD)

        for left in reversed(range(self.kills)):
            number = SIGNALS[left % len(SIGNALS)]
            at = self.rng.randint(first, last) if left else first + 1
            child = os.fork()
            if not child:
                _die_at(at, number)
                return True
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            self._account(target, number, code, is_last=not left)
            self._look(target, whole)

        for number in range(self.points):
            room = len(whole) * number // self.points
            child = os.fork()
            if not child:
                resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
                return True
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            self.too_small += 1
            if code != 2 or any(files.leftovers(target)):
                self.wrong.append(
                    f"{target.name}: {code} or litter with room for {room} bytes"
                )
            self._look(target, whole)
        return False

    def _account(self, target: Path, number: int, code: int, *, is_last: bool) -> None:
        """Count a fork that got a signal; `is_last`: its litter is for the next run."""
        litter = list(files.leftovers(target))
        if number == signal.SIGKILL:
            self.killed += code == -signal.SIGKILL
            self.inside += bool(litter)
            for rest in () if is_last else litter:
                rest.unlink()
        else:
            self.killed += code in (0, 1, EXIT_INTERRUPTED)
            self.inside += code == EXIT_INTERRUPTED
            if litter or code not in (0, 1, EXIT_INTERRUPTED):
                self.wrong.append(f"{target.name}: {code} or litter after SIGINT")

    def _look(self, target: Path, whole: bytes) -> None:
        """Note a file that is neither the old one nor the whole new one."""
        if target.read_bytes() not in (OLD, whole):
            self.wrong.append(f"{target.name} is half written")
        target.write_bytes(OLD)


def _count_events(pipe: int, target: Path) -> None:
    """Tell between which calls and returns a file is written and gets its name."""
    count = first = 0

    def profile(frame: FrameType, event: str, _: object) -> None:
        nonlocal count, first
        count += 1
        if not first and any(files.leftovers(target)):
            first = count
        # Other functions are called `replace` as well.
        is_named = frame.f_code is Path.replace.__code__
        if event == "return" and is_named and frame.f_locals["target"] == target:
            os.write(pipe, f"{first} {count + AFTER}".encode())
            # The rest of the command is for the others.
            os._exit(0)

    sys.setprofile(profile)


def _die_at(last: int, number: int) -> None:
    count = 0
    # A shell that starts this in the background lets it ignore interrupts.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def profile(*_: object) -> None:
        nonlocal count
        count += 1
        if count >= last:
            sys.setprofile(None)
            os.kill(os.getpid(), number)

    sys.setprofile(profile)


def run_in(folder: Path, line: Sequence[str], before: Callable[[Path], object]) -> None:
    """Run a command in an empty folder, and something before each file; a fork ends
    here.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    parent, own, begun = os.getpid(), files._without_leftovers, Path.cwd()

    def hooked(target: Path) -> None:
        before(target.resolve())
        own(target)

    with mock.patch.object(files, "_without_leftovers", hooked):
        os.chdir(folder)
        try:
            code, said, why = answer(list(line), PATIENCE_S)
        finally:
            if os.getpid() == parent:
                os.chdir(begun)
    if os.getpid() != parent:
        os._exit(70 if why and code != EXIT_INTERRUPTED else code)
    if code not in (0, 1) or why:
        raise RuntimeError(f"{' '.join(line)}: {said}")


def torment(
    folder: Path, line: Sequence[str], kills: int, points: int = POINTS
) -> tuple[Forks, int]:
    """Kill a command while it writes, that often in all.

    Returns
    -------
    forks : Forks
        What came of it; its `wrong` is complete.
    n_files : int
        The files that the command writes.
    """
    parent = os.getpid()
    written: list[Path] = []
    run_in(folder, line, written.append)
    targets = set(written)
    forks = Forks(math.ceil(kills / max(len(written), 1)), points)
    run_in(folder, line, lambda x: os.getpid() == parent and forks.of(x))

    rest = {path for path in folder.rglob("*") if path.is_file()} ^ targets
    forks.wrong += [f"{path.name} is left over or missing" for path in rest]
    return forks, len(targets)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.kills", description=__doc__
    )
    parser.add_argument("--kills", type=int, default=200, help="of each command")
    parser.add_argument("--only", default="", help="commands with this in their line")
    parser.add_argument(
        "--write",
        action="store_true",
        help="put the table into docs/evidence/damage.md",
    )
    chosen = parser.parse_args()
    cells: list[list[str]] = []
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        for label, line in sound_commands(Path(name)):
            if chosen.only not in label or "out" not in label:
                continue
            try:
                forks, n_files = torment(Path(name) / "tormented", line, chosen.kills)
            except RuntimeError as error:  # it does not work on sound files
                wrong.append(str(error))
                sys.stderr.write(f"{error}\n")
                continue
            counts = (n_files, forks.killed, forks.inside, forks.too_small)
            cells.append([label, *map(str, (*counts, len(forks.wrong)))])
            wrong += [f"{label}: {text}" for text in forks.wrong]
            sys.stderr.write(f"{' '.join(cells[-1])} {forks.wrong[:3]}\n")
    show("evidence/damage.md", "kills", table(HEADER, cells), kept=chosen.write)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
