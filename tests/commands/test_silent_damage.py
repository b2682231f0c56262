"""Damage that nobody sees in the numbers: a stage says of its log what `inspect` says of it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.inspect.findings import ERRORS
from tests import ROOT

SAMPLES = ROOT / "sample_logs" / "one_joint"
TRIAL = SAMPLES / "friction" / "joint_1.parquet"
ROBOT = ("-r", str(SAMPLES / "robot.toml"))


def changed(folder: Path, name: str, change: Callable[[np.ndarray], None]) -> Path:
    """The friction trials with one column changed."""
    trial, path = pq.read_table(TRIAL), folder / "log.parquet"
    values = trial.column(name).to_numpy().copy()
    change(values)
    place = trial.schema.names.index(name)
    pq.write_table(trial.set_column(place, name, pa.array(values)), path)
    return path


def hole(values: np.ndarray) -> None:
    values[300:420] = np.nan


def spike(values: np.ndarray) -> None:
    values[len(values) // 2] += 0.3


@pytest.mark.parametrize(
    ("name", "change", "code"),
    [
        ("joint_1.position", hole, "channel_hole"),
        ("joint_1.current", hole, "channel_hole"),
        pytest.param("joint_1.position", spike, "position_spikes", marks=pytest.mark.slow),
    ],
)
def test_a_stage_says_what_inspect_says(
    name: str,
    change: Callable[[np.ndarray], None],
    code: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = str(changed(tmp_path, name, change))
    severe = int(code in ERRORS)  # what is left out makes nothing wrong
    assert main(["inspect", log, *ROBOT]) == severe
    assert code in "".join(capsys.readouterr())
    out = tmp_path / "f.json"
    assert main(["friction", log, *ROBOT, "--strict", "-o", str(out)]) == severe
    assert f"[{code}]" in out.read_text("utf-8")
    assert not severe or f"{log}: [{code}] joint_1" in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["cut", "gap"])
def test_a_table_that_is_cut_or_has_a_gap(
    damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.csv"
    pa.csv.write_csv(pq.read_table(TRIAL).slice(0, 40_000), path)
    raw = path.read_bytes()
    if damage == "cut":
        path.write_bytes(raw[: len(raw) - 7])
    else:
        lines = raw.splitlines(keepends=True)
        path.write_bytes(b"".join([*lines[:400], *lines[700:]]))
    main(["friction", str(path), *ROBOT, "-o", str(tmp_path / "f.json")])
    said = " ".join(capsys.readouterr().err.split())
    assert {"cut": "cut short, it is left out", "gap": "[clock_gap]"}[damage] in said
    assert str(path) in said
