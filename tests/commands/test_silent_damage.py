"""Damage that nobody sees in the numbers: a stage says of its log what `inspect` says of it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from pyarrow import csv

from seqid_cli.__main__ import main
from seqid_cli.inspect.findings import ERRORS
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

TRIAL = SAMPLES / "one_joint" / "friction" / "joint_1.parquet"
ROBOT = ("-r", str(SAMPLES / "one_joint" / "robot.toml"))


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
    columns, log = read_columns(TRIAL), str(tmp_path / "log.parquet")
    change(columns[name])
    write_columns(tmp_path / "log.parquet", columns)
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
    csv.write_csv(pq.read_table(TRIAL).slice(0, 40_000), path)
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
