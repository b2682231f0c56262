"""Logs that change or vanish, little memory, long logs; commands killed or on a full
disk.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.discover import excerpts
from seqid_cli.identify.prediction.predict import LogPrediction, LongPrediction
from seqid_cli.inspect import inspection, propose
from seqid_cli.logs import long as long_logs
from seqid_cli.logs import pieces
from seqid_cli.logs.contents import LogContents, contents_of
from seqid_cli.logs.log_file import LogFile
from seqid_cli.motion import blocks
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.commands.conftest import ONE_JOINT, Rig
from tests.plants.robots.seven_joint import known_model, write_arm, write_log
from tests.studies.kills import torment
from tests.studies.soak import write_log as write_hours
from tests.unit.logs import format_writers as formats

ROBOT = ("-r", str(ONE_JOINT / "robot.toml"))
MODEL = ("-p", str(ONE_JOINT / "golden.json"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda path: os.truncate(path, path.stat().st_size // 2), "changed while"),
        (lambda path: os.truncate(path, path.stat().st_size + 4), "changed while"),
        (Path.unlink, "cannot be read"),
    ],
    ids=["cut", "grown", "gone"],
)
def test_a_log_that_changes_is_refused(
    change: Callable[[Path], None], said: str, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, own = rig.folder / "log.parquet", LogFile.whole
    shutil.copy(ONE_JOINT / "validation" / "point_to_point.parquet", log)

    def changing(*arguments: object) -> object:
        raw = own(*arguments)  # type: ignore[arg-type]
        change(log)
        return raw

    monkeypatch.setattr(LogFile, "whole", changing)
    done = rig.run("predict", "log.parquet", *ROBOT, *MODEL, "-o", "p.json")
    assert done.code == 2
    assert said in done.err
    assert not (rig.folder / "p.json").exists()


@pytest.mark.parametrize("command", ["inspect", "init"])
def test_a_log_that_grows_between_two_looks_is_refused(
    command: str, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its channels are those of one look, and what they say of another."""
    log = formats.csv_own(
        rig.folder / "log.csv", formats.moving(["shoulder", "elbow"], 60)
    )

    def growing(path: Path, *, glance: bool = False) -> LogContents:
        contents = contents_of(path, glance=glance)
        with log.open("a") as stream:
            stream.write(log.read_text().splitlines()[-1] + "\n")
        return contents

    for module in (inspection, propose):
        monkeypatch.setattr(module, "contents_of", growing)
    done = rig.run(command, "log.csv", "-o", "out.toml")
    assert done.code == 2
    assert "changed while it was read" in done.err


def test_too_little_memory_is_no_bug(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError("Unable to allocate 8 GiB")

    monkeypatch.setattr(LogFile, "whole", full)
    done = rig.run("predict", str(ONE_JOINT / "validation"), *ROBOT, *MODEL)
    assert done.code == 2
    assert "there is too little memory (Unable to allocate 8 GiB)" in done.err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")
def test_a_gibibyte_and_64_files_are_enough(tmp_path: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))

    command = [
        sys.executable,
        "-m",
        "seqid_cli",
        "friction",
        str(ONE_JOINT / "friction"),
        *ROBOT,
    ]
    done = subprocess.run(
        [*command, "-o", str(tmp_path / "f.json")],
        preexec_fn=limit,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")
@pytest.mark.parametrize("command", ["inspect", "diagnose"])
def test_memory_of_long_logs(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts, taken = (
        pieces.read_parts.__kwdefaults__,
        excerpts.take_excerpts.__kwdefaults__,
    )
    assert parts is not None
    assert taken is not None
    monkeypatch.setitem(parts, "most_values", 300_000)
    monkeypatch.setitem(taken, "most_values", 120_000)
    monkeypatch.setattr(excerpts, "PASSED_OVER", 1000)
    model = () if command == "inspect" else MODEL

    def lines(minutes: float) -> list[str]:
        log, out = tmp_path / f"{minutes}.parquet", tmp_path / "out.json"
        write_hours(log, minutes / 60.0)
        return [command, str(log), *ROBOT, *model, "-o", str(out)]

    def peak(line: list[str]) -> int:
        tracemalloc.start()
        assert main(line) == 0
        held = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return held

    short, long = lines(1.0), lines(2.0)
    assert main(short) == 0  # what is made once is there
    assert peak(long) < 1.2 * peak(short)


def flattened(document: Any, prefix: str = "") -> dict[str, Any]:
    """Return the leaves of a nested document, each under the path of its keys."""
    if not isinstance(document, dict):
        return {prefix: document}
    leaves: dict[str, Any] = {}
    for key, value in document.items():
        leaves |= flattened(value, prefix=f"{prefix}/{key}")
    return leaves


@pytest.mark.slow
def test_long_logs_give_the_same_files(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log that is passed over part by part, as held; beside a short one."""
    robot = load_robot(write_arm(rig.folder))
    logs = [
        str(write_log(rig.folder / f"{count}.parquet", robot, count))
        for count in (6_000, 1_500)
    ]
    model = known_model(robot, 1.02)
    own = {"friction": model.friction, "inertia": model.inertia}
    rig.params("model.json", with_stage(None, robot_id(robot), [], **own))
    parts, passed = [], LongPrediction.__iter__

    def watched(long: LongPrediction) -> Iterator[LogPrediction]:
        for part in passed(long):
            parts.append(part)
            yield part

    monkeypatch.setattr(LongPrediction, "__iter__", watched)

    def predict(name: str) -> tuple[dict[str, Any], pa.Table]:
        given = ("-r", "robot.toml", "-p", "model.json", "--cutoff", "20")
        outputs = ("-o", f"{name}.json", "--torques", f"{name}.parquet")
        done = rig.run("predict", *logs, *given, *outputs)
        assert done.code == 0, done.err
        document = json.loads((rig.folder / f"{name}.json").read_text())
        return document, pq.read_table(rig.folder / f"{name}.parquet")

    held, expected = predict("held")
    assert not parts
    monkeypatch.setattr(long_logs, "LONG", 5_000)
    monkeypatch.setattr(LongPrediction, "rows", 1_500)
    monkeypatch.setattr(blocks, "LEAST_BLOCK", 2_000)
    long, found = predict("long")
    assert len(parts) > 1
    for one, other in ((long, held), *zip(long["logs"], held["logs"], strict=True)):
        for joint, errors in other["joints"].items():
            found_errors, wanted_errors = (
                flattened(one["joints"][joint]),
                flattened(errors),
            )
            assert found_errors.keys() == wanted_errors.keys(), joint
            for key, wanted in wanted_errors.items():
                expected_error = (
                    None if wanted is None else pytest.approx(wanted, rel=1e-6)
                )
                assert found_errors[key] == expected_error, f"{joint}{key}"
    assert (long["stages"], long["inputs"]) == (held["stages"], held["inputs"])
    assert found.schema == expected.schema
    for name in found.column_names:
        values, wanted = (table[name].to_numpy() for table in (found, expected))
        if wanted.dtype == np.float64:
            scale = np.nanmax(np.abs(wanted))
            np.testing.assert_allclose(
                values, wanted, rtol=0.0, atol=1e-9 * scale, err_msg=name
            )
        else:
            np.testing.assert_array_equal(values, wanted, err_msg=name)


PREDICT = ("predict", str(ONE_JOINT / "validation"), *ROBOT, *MODEL, "-o", "a.json")
COMMANDS = {
    "friction": ("friction", str(ONE_JOINT / "friction"), *ROBOT, "-o", "a.json"),
    "predict": (*PREDICT, "--torques", "t.parquet"),
    "predict, MCAP": (*PREDICT, "--torques", "t.mcap"),
    "trend": (
        "trend",
        MODEL[1],
        "../later.json",
        "-o",
        "a[1].json",
        "--table",
        "t.parquet",
    ),
    "report": ("report", MODEL[1], "-o", "a.html"),
    "inspect": ("inspect", str(ONE_JOINT / "gravity"), *ROBOT, "-o", "a.json"),
    "plan": ("plan", "friction", *ROBOT, *MODEL, "-o", "a.json"),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("friction", 1),
        ("trend", 2),
        pytest.param("predict, MCAP", 2, marks=pytest.mark.slow),
        pytest.param("predict", 2, marks=pytest.mark.slow),
        pytest.param("report", 1, marks=pytest.mark.slow),
        pytest.param("inspect", 1, marks=pytest.mark.slow),
        pytest.param("plan", 1, marks=pytest.mark.slow),
    ],
)
def test_old_files_stay_whole(name: str, count: int, tmp_path: Path) -> None:
    later = json.loads(Path(MODEL[1]).read_text()) | {"created": "2031-01-01T00:00:00Z"}
    (tmp_path / "later.json").write_text(json.dumps(later))
    forks, n_files = torment(tmp_path / "out", COMMANDS[name], kills=12, points=6)
    assert not forks.wrong
    assert n_files == count
    assert forks.killed >= 10
    assert forks.inside
