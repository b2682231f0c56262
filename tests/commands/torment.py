"""Kill commands while they write, and fill the disk under them.

A command runs once on the sample robot. Whenever it begins to write a file, it is forked: each fork
goes on from there and is killed at a random call or return of the writing, or may write so many
bytes only. After each the old file or the new one must be there, whole. In the end the first
process writes, and nothing else may lie in the folder.
"""

import json
import math
import os
import random
import resource
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from seqid_cli.params import files
from tests import ROOT
from tests.studies.fuzz.answers import answer

SAMPLE = ROOT / "sample_logs" / "one_joint"
AFTER = 2  # calls and returns after a file has its name, in which it may be killed as well
OLD = b"what was there before\n"
_GOLDEN = str(SAMPLE / "golden.json")
_R = ("-r", str(SAMPLE / "robot.toml"))
_PREDICT = ("predict", str(SAMPLE / "validation"), *_R, "-p", _GOLDEN, "-o", "{}/a.json")
Line = tuple[str, ...]
COMMANDS: dict[str, Line] = {  # {} is the folder for the output
    "friction": ("friction", str(SAMPLE / "friction"), *_R, "-o", "{}/a.json"),
    "predict": (*_PREDICT, "--torques", "{}/t.parquet"),
    "predict, MCAP": (*_PREDICT, "--torques", "{}/t.mcap"),
    "trend": ("trend", _GOLDEN, "{}/../later.json", "-o", "{}/a.json", "--table", "{}/t.parquet"),
    "report": ("report", _GOLDEN, "-o", "{}/a.html"),
}


@dataclass
class Forks:
    """How many there shall be of each file, and what came of them.

    `inside` were killed when a temporary file was there; `seen` is what stood in a file afterwards
    other than the old content, and `wrong` what must not be.
    """

    kills: int
    points: int
    sizes: dict[Path, int]
    rng: random.Random = field(default_factory=lambda: random.Random(0))
    killed: int = 0
    inside: int = 0
    full: int = 0
    seen: list[tuple[Path, bytes]] = field(default_factory=list)
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
        self._look(target)
        for left in reversed(range(self.kills)):
            at = self.rng.randint(first, last) if left else first + 1
            child = os.fork()
            if not child:
                _die_at(at)
                return True
            killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
            self.killed += killed
            for rest in target.parent.glob(f".*.{child}.tmp"):
                self.inside += 1
                if left:  # the last is for the next run
                    rest.unlink()
            self._look(target)
        for number in range(self.points):
            room = self.sizes[target] * number // self.points
            child = os.fork()
            if not child:
                resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
                return True
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            if code != 2:
                self.wrong.append(f"{target.name}: {code} with room for {room} bytes")
            if any(target.parent.glob(f".*.{child}.tmp")):
                self.wrong.append(f"{target.name}: litter on a full disk")
            self.full += 1
            self._look(target)
        return False

    def _look(self, target: Path) -> None:
        content = target.read_bytes()
        if content != OLD:
            self.seen.append((target, content))
            target.write_bytes(OLD)


def _count_events(pipe: int, target: Path) -> None:
    """Tell between which calls and returns a file is written and gets its name."""
    count = first = 0
    temporary = files._temporary(target)

    def profile(frame: FrameType, event: str, _: object) -> None:
        nonlocal count, first
        count += 1
        name = frame.f_code.co_name if event == "return" else ""
        if not first and temporary.exists():
            first = count
        if name == "replace":
            sys.setprofile(None)
            os.write(pipe, f"{first} {count + AFTER}".encode())
            os.close(pipe)

    sys.setprofile(profile)


def _die_at(last: int) -> None:
    """Kill this process at a call or return."""
    count = 0

    def profile(*_: object) -> None:
        nonlocal count
        count += 1
        if count >= last:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.setprofile(profile)


def torment(line: Line, work: Path, *, kills: int, points: int) -> Forks:
    """Run a command in an empty folder, with so many `kills` and full disks (`points`) in all."""
    folder, parent = work / "out", os.getpid()
    later = json.loads(Path(_GOLDEN).read_text()) | {"created": "2031-01-01T00:00:00Z"}
    (work / "later.json").write_text(json.dumps(later))
    arguments = [part.replace("{}", str(folder)) for part in line]
    targets: list[Path] = []
    _run(arguments, folder, targets.append)
    sizes = {target: target.stat().st_size for target in targets}
    forks = Forks(math.ceil(kills / len(sizes)), math.ceil(points / len(sizes)), sizes)
    _run(arguments, folder, lambda target: os.getpid() == parent and forks.of(target))
    for target, content in forks.seen:
        if content != target.read_bytes():
            forks.wrong.append(f"{target.name}: {len(content)} bytes, neither old nor new")
    here = {path for path in folder.rglob("*") if path.is_file()}
    forks.wrong += [f"litter: {path.name}" for path in here - set(sizes)]
    return forks


def _run(arguments: Sequence[str], folder: Path, before: Callable[[Path], object]) -> None:
    """Run a command in an empty folder; a fork ends here."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    parent = os.getpid()
    with _hooked(before):
        code, said, why = answer(arguments, 600.0)
    if os.getpid() != parent:
        os._exit(70 if why else code)
    if code not in (0, 1) or why:
        raise RuntimeError(f"{' '.join(arguments)}: exit {code} {why}: {said[-500:]}")


@contextmanager
def _hooked(before: Callable[[Path], object]) -> Iterator[None]:
    own = files._without_leftovers

    def hooked(target: Path) -> None:
        before(target)
        own(target)

    files._without_leftovers = hooked
    try:
        yield
    finally:
        files._without_leftovers = own
