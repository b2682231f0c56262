"""The same inputs, options and version give the same bytes, whenever it is."""

import json
import os
import shutil
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from seqid_cli.params import dates
from tests.commands.conftest import ONE_JOINT, Rig

ROBOT = ("-r", "logs/robot.toml")
MODEL = (*ROBOT, "-p", "logs/golden.json")
TORQUES = ("--torques", "out/torques.parquet")
TREND_TABLE = ("--table", "out/trend.parquet")
# Given, because to look for them takes most of the stage's time.
ORDERS = ("--position-order", "4", "--velocity-order", "5")
FRICTION = ("friction", "logs/friction", *ROBOT, *ORDERS)
LINES = (
    (*FRICTION, "-o", "out/friction.json"),
    ("predict", "logs/validation", *MODEL, "-o", "out/prediction.json", *TORQUES),
    ("predict", "logs/validation", *MODEL, "--torques", "out/torques.mcap"),
    ("inspect", "logs/validation", *ROBOT, "-o", "out/inspection.json"),
    ("plan", "friction", *ROBOT, "-o", "out/plan.json"),
    ("compare", "logs/golden.json", "logs/golden.json", "--json"),
    ("export", "logs/golden.json", *ROBOT, "-o", "out/arm.h", "--json"),
    ("trend", "logs/golden.json", "later.json", "-o", "out/trend.json", *TREND_TABLE),
    ("report", "logs/golden.json", "-o", "out/report.html", "--json"),
)


@pytest.fixture
def lab(rig: Rig) -> Rig:
    shutil.copytree(ONE_JOINT, rig.folder / "logs")
    later = json.loads((ONE_JOINT / "golden.json").read_text())
    later["created"] = "2031-01-01T00:00:00Z"
    (rig.folder / "later.json").write_text(json.dumps(later))
    return rig


def made(lab: Rig) -> dict[str, bytes]:
    """Run all commands into one folder; what is there and what they printed,
    by name.
    """
    out = lab.folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    found = {}
    for number, line in enumerate(LINES):
        done = lab.run(*line, "--quiet")
        assert done.code in (0, 1), done.err
        found[f"{number} on the screen"] = (done.out + done.err).encode()
    return found | {path.name: path.read_bytes() for path in out.iterdir()}


@pytest.mark.slow
def test_a_command_that_runs_again_writes_the_same_bytes(lab: Rig) -> None:
    first = made(lab)
    time.sleep(1.1)  # `created` counts seconds
    second = made(lab)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []
    assert len(first) > len(LINES)


def created(lab: Rig, *line: str) -> str:
    done = lab.run(*line, "--quiet", "--json")
    assert done.code in (0, 1), done.err
    return str(json.loads(done.out)["created"])


def test_created_is_that_of_the_newest_input(
    lab: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in (lab.folder / "logs").rglob("*"):
        os.utime(path, (1_700_000_000, 1_700_000_000))
    assert created(lab, *FRICTION) == "2023-11-14T22:13:20Z"
    assert (
        created(lab, "plan", "friction", "-r", "logs/robot.toml")
        == "2023-11-14T22:13:20Z"
    )

    golden = json.loads((ONE_JOINT / "golden.json").read_text())["created"]
    model = ("-r", "logs/robot.toml", "-p", "logs/golden.json")
    assert created(lab, "predict", "logs/validation", *model) == golden
    assert (
        created(lab, "trend", "logs/golden.json", "later.json")
        == "2031-01-01T00:00:00Z"
    )
    assert (
        created(lab, "compare", "later.json", "logs/golden.json")
        == "2031-01-01T00:00:00Z"
    )
    lab.run("report", "later.json", "-o", "page.html")
    assert '<time datetime="2031-01-01T00:00:00Z">' in Path("page.html").read_text()

    monkeypatch.setenv(dates.VARIABLE, "1600000000")
    assert created(lab, *FRICTION) == "2020-09-13T12:26:40Z"
    monkeypatch.setenv(dates.VARIABLE, "monday")
    done = lab.run(*FRICTION)
    assert done.code == 2
    assert "SOURCE_DATE_EPOCH is no number of seconds: 'monday'" in done.err


def test_stamps_that_are_dates_date_a_result(lab: Rig) -> None:
    (log,) = (ONE_JOINT / "friction").glob("*.parquet")
    table = pq.read_table(log)
    place = table.schema.get_field_index("t")
    days = pc.add(table["t"], pa.scalar(1_767_225_600.0))
    pq.write_table(table.set_column(place, "t", days), "dated.parquet")
    line = ("friction", "dated.parquet", *ROBOT, *ORDERS)
    done = lab.run(*line, "--quiet", "--json")
    file = json.loads(done.out)
    assert file["created"] == "2026-01-01T00:01:47Z"
    first, last = file["inputs"][0]["recorded"]
    assert first.startswith("2026-01-01T00:00:00.000")
    assert last.startswith("2026-01-01T00:01:47.245")
