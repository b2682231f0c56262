"""A folder to run commands in, what they show to the letter, and what stands in for the
work.

In `transcripts/` a line `$ compare a.json b.json` is a command line. Below stand its
lines on stdout, those on stderr behind `! `, and its exit code in brackets; hashes are
left out.
"""

import hashlib
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from seqid_cli.__main__ import main
from seqid_cli.discover.excerpts import Excerpts
from seqid_cli.inspect.findings import located
from seqid_cli.inspect.screening import Opened
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT
from tests.plants.robots.made import made_recording
from tests.transcripts import check_text
from tests.unit.params.documents import JOINTS

ROBOT_TOML = (
    'schema = "seqid/robot@1"\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n'
    + "".join(
        f'[[joint]]\nname = "{name}"\ndh = {{ alpha = 0.0, a = 0.3, d = 0.0, theta0 ='
        " 0.0 }\n"
        for name in JOINTS
    )
    + '[[imu]]\nname = "imu_a"\nafter_joint = "elbow"\ngyro = true\n'
)
SAMPLES = 5


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


@dataclass
class Rig:
    """A folder with a robot file and two logs, and a way to run commands in it."""

    folder: Path
    run: Callable[..., Done]

    def params(self, name: str, file: ParameterFile) -> str:
        """Write a parameter file that this rig's robot file fits to."""
        file.robot.sha256 = load_robot(self.folder / "robot.toml").sha256
        write_json_atomic(self.folder / name, file)
        return name

    def check_transcript(self, name: str, words: Mapping[str, str] = {}) -> None:
        """Run a transcript again; some `words` in it stand for others that change
        nothing shown.
        """
        path = Path(__file__).parent / "transcripts" / f"{name}.txt"
        lines = re.findall(
            r"^\$ (.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE
        )
        assert lines
        shown = []
        for line in lines:
            done = self.run(*(words.get(word, word) for word in shlex.split(line)))
            said = [f"! {text}".rstrip() for text in done.err.splitlines()]
            shown += [f"$ {line}", *done.out.splitlines(), *said, f"[{done.code}]", ""]
        check_text(path, re.sub(r"\b[0-9a-f]{12}\b", "<hash>", "\n".join(shown)))


SAMPLE_LOGS = ROOT / "sample_logs"
ONE_JOINT = SAMPLE_LOGS / "one_joint"


def content(number: int) -> bytes:
    """What looks like a Parquet file from outside."""
    return b"PAR1" + bytes([number]) * 16 + b"PAR1"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Rig:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT_TOML)
    for number, name in enumerate("ab"):
        (tmp_path / f"{name}.parquet").write_bytes(content(number))

    def run(*arguments: str) -> Done:
        code = main(arguments)
        captured = capsys.readouterr()
        return Done(code, captured.out, captured.err)

    return Rig(tmp_path, run)


@dataclass
class Reader:
    """Stands in for the log reader: short recordings of zeros."""

    warnings: tuple[str, ...] = ()
    partial: str = ""
    reading: Reading = HEADER_STAMPS
    findings: tuple[InspectionFinding, ...] = ()

    def open_screened(
        self, path: Path, robot: Robot, *, reading: Reading, **_: object
    ) -> Opened:
        self.reading = reading
        recording = made_recording(
            np.zeros((SAMPLES, robot.n)),
            np.ones((SAMPLES, robot.n)),
            rate_hz=100.0,
            path=str(path),
            sha256=sha256(Path(path).read_bytes()),
            format="parquet",
            health=Health(rate_hz=100.0, jitter=0.0, warnings=self.warnings),
            partial=self.partial,
        )
        return Opened(recording, located(self.findings, path))


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Reader:
    fake = Reader()
    monkeypatch.setattr("seqid_cli.identify.log_set.open_screened", fake.open_screened)
    return fake


@pytest.fixture
def gathering(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hold all logs: those of the fake reader are no files that could be passed
    over.
    """

    def take(recordings: Iterable[Recording], *_: object, **__: object) -> Excerpts:
        return Excerpts(tuple(recordings))

    monkeypatch.setattr("seqid_cli.discover.excerpts.take_excerpts", take)
    monkeypatch.setattr(
        "seqid_cli.discover.refinement.earlier_logs.take_excerpts", take
    )
    monkeypatch.setattr(
        "seqid_cli.discover.refinement.earlier_logs.likely_rows", lambda *_: 0
    )


def stand_in(monkeypatch: pytest.MonkeyPatch, name: str, **functions: object) -> None:
    """Put a module with these functions alone in the place of one of the package."""
    module = ModuleType(f"seqid_cli.{name}")
    vars(module).update(functions)
    monkeypatch.setitem(sys.modules, module.__name__, module)


@pytest.fixture
def identified(
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[str, str, object], list[object]]:
    """Replace one identification function by one that reads all logs and returns a
    result.

    An exception as the result is raised. Returns the list that the calls' arguments end
    up in.
    """

    def replaced(module_name: str, function: str, result: object) -> list[object]:
        calls: list[object] = []

        def fake(
            recordings: Iterable[Recording], *arguments: object, **more: object
        ) -> object:
            calls.extend([len(list(recordings)), *arguments, *more.values()])
            if isinstance(result, BaseException):
                raise result
            return result

        stand_in(monkeypatch, f"identify.{module_name}", **{function: fake})
        return calls

    return replaced
