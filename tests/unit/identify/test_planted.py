"""Faults of logs: every stage that reads them says so, and sound logs are good."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seqid_cli import identify
from seqid_cli.errors import SeqidError
from tests.unit.inspect import planting as p
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns
from tests.unit.inspect.planting import Columns, Plant

pytestmark = pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")

RIG = SAMPLES / "one_joint"
ROBOT, GOLDEN = RIG / "robot.toml", RIG / "golden.json"
FOLDERS = ("gravity", "imu", "inertia", "simultaneous", "validation")


def spike(columns: Columns, rng: np.random.Generator) -> None:
    q = columns["joint_1.position"]
    moving = np.flatnonzero(np.abs(np.gradient(q, columns["t"])) > 0.05)
    inner = moving[(moving > len(q) // 8) & (moving < len(q) - len(q) // 8)]
    q[rng.choice(inner)] += 0.3


FAULTS: Mapping[str, Plant] = {
    "none": p.nothing,
    "wrong sign": p.negated("joint_1.current"),
    "amperes as torque": p.renamed("current", "torque"),
    "degrees": p.times(180.0 / np.pi, "joint_1.position"),
    "spike": spike,
}
NEEDS_NO_TORQUE = {"wrong sign", "amperes as torque"}  # of imu-calib


def planted(fault: str, stage: str, folder: Path) -> Iterator[Path]:
    """Logs of a stage with the fault in all of them; a spike is in the one in the
    middle.
    """
    logs = sorted(
        (RIG / {"simultaneous": "inertia"}.get(stage, stage)).glob("*.parquet")
    )
    for number, path in enumerate(logs):
        if fault == "none" or (fault == "spike" and number != len(logs) // 2):
            yield path
            continue
        columns = read_columns(path)
        FAULTS[fault](columns, np.random.default_rng(11))
        yield folder / path.name
        write_columns(folder / path.name, columns)


def verdicts(stage: str, logs: Sequence[Path]) -> Sequence[Any]:
    """Verdicts of a stage on logs, with the results before it of sound ones."""
    if stage == "validation":
        return identify.predict(logs, ROBOT, GOLDEN).verdicts
    if stage == "simultaneous":
        stages = identify.simultaneous(logs, ROBOT).stages
        return [*stages.friction.verdicts, *stages.inertia.verdicts]
    run = getattr(identify, "imu_calib" if stage == "imu" else stage)
    return getattr(run(logs, ROBOT, parameters=GOLDEN).stages, stage).verdicts


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("stage", FOLDERS)
def test_the_stage_says_it(stage: str, fault: str, tmp_path: Path) -> None:
    logs = list(planted(fault, stage, tmp_path))
    try:
        poor = [v for v in verdicts(stage, logs) if not v.good]
    except SeqidError:
        assert fault != "none"
        return
    if fault == "none":
        # The dry friction of this arm waves over the position, which one-step friction
        # cannot hold.
        expected = {"usable"} if stage == "simultaneous" else set()
        assert {verdict.level for verdict in poor} == expected
    elif stage != "imu" or fault not in NEEDS_NO_TORQUE:
        assert any("joint_1" in f"{v.joint}: {v.reason}" for v in poor)


@pytest.mark.slow
def test_a_spike_does_not_spoil_the_prediction(tmp_path: Path) -> None:
    """One damaged sample used to make the error seven times as large."""
    logs = [list(planted(fault, "validation", tmp_path)) for fault in ("none", "spike")]
    sound, found = (identify.predict(own, ROBOT, GOLDEN) for own in logs)
    assert found.joints["joint_1"].rmse == pytest.approx(
        sound.joints["joint_1"].rmse, rel=0.03
    )
    assert not any(verdict.good for verdict in found.verdicts if not verdict.joint)
