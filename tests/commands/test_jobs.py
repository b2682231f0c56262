"""Commands with several processes: what they say of logs that fail, are copies or do not fit."""

import importlib.util
import json
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from seqid_cli.params.io import read_parameters
from tests.commands.conftest import ONE_JOINT, Rig
from tests.commands.transcripts import check_transcript

FRICTION = ONE_JOINT / "friction"


@pytest.fixture
def logs(rig: Rig) -> Rig:
    """A rig with three logs: a good one, one without torque and one that is cut short."""
    shutil.copy(ONE_JOINT / "robot.toml", rig.folder / "robot.toml")
    good = next(iter(sorted(FRICTION.glob("*.parquet"))))
    shutil.copy(good, rig.folder / "a.parquet")
    table = pq.read_table(good)
    kept = [name for name in table.column_names if not name.endswith((".current", ".torque"))]
    pq.write_table(table.select(kept), rig.folder / "b.parquet")
    (rig.folder / "c.parquet").write_bytes(b"PAR1 and no more")
    return rig


def without_time(path: Path) -> dict[str, object]:
    document: dict[str, object] = json.loads(path.read_text())
    del document["created"]
    return document


def test_processes_change_no_bit(logs: Rig) -> None:
    """The other stages: see `test_repeat`; here with the torques of a prediction."""
    folders, golden = [str(ONE_JOINT / "validation")], "golden.json"
    model, found = ["-r", "robot.toml", "-p", str(ONE_JOINT / golden)], []
    for jobs in ("1", "2"):
        output, torques = logs.folder / "out.json", logs.folder / "t.parquet"
        files = ["-o", output.name, "--torques", torques.name, "--jobs", jobs]
        done = logs.run("predict", *folders, *model, *files, "--motion", "encoder")
        assert done.code == 0, done.err
        found.append((without_time(output), torques.read_bytes(), done.out, done.err))
    assert found[0] == found[1]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_logs_that_fail_stop_a_command_or_are_left_out(jobs: str, logs: Rig) -> None:
    shutil.copy(logs.folder / "a.parquet", logs.folder / "copy.parquet")
    check_transcript(logs, "jobs", {"JOBS": jobs})
    assert not (logs.folder / "failed.json").exists()
    alone, copied, skipped = (
        read_parameters(logs.folder / f"{name}.json") for name in ("alone", "copied", "skipped")
    )
    assert alone.stages.friction.joints == copied.stages.friction.joints
    assert [log.path for log in skipped.inputs] == ["a.parquet"]
    notes = "\n".join(skipped.stages.friction.notes)
    assert all(f"left out: {path}" in notes for path in ("b.parquet", "c.parquet", "none.parquet"))


def test_dask_that_is_not_installed_is_named_with_its_remedy(
    logs: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *more: None if name == "distributed" else found(name, *more),
    )
    done = logs.run("friction", "a.parquet", "-r", "robot.toml", "--engine", "dask")
    assert done.code == 2
    assert "pip install 'seqid[dask]'" in done.err
