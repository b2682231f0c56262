"""`seqid predict` on MCAP logs that are passed over: the same files as of held ones."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from seqid_cli.identify.prediction.predict import LogPrediction, LongPrediction
from seqid_cli.identify.regression import equations
from seqid_cli.motion import blocks
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import inverse_dynamics
from tests.commands.conftest import Rig
from tests.plants.robots.seven_joint import COULOMB, JOINTS, RATE_HZ, known_model, motion, write_arm
from tests.unit.logs.writers import joint_messages, write_messages

pytestmark = pytest.mark.slow

LOGS = {"a.mcap": 6_000, "b.mcap": 1_500}  # samples; the first is long
T0 = 1_700_000_000_000_000_000
JITTER_S = 2e-5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    robot = load_robot(write_arm(folder))
    rng = np.random.default_rng(8)
    for number, (name, samples) in enumerate(LOGS.items()):
        t = np.arange(samples) / RATE_HZ + rng.uniform(-JITTER_S, JITTER_S, samples)
        path = folder / name
        start_ns = T0 + number * 60 * 10**9
        assert robot.nominal is not None
        q, dq, ddq = motion(t)
        tau = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, dq, ddq)
        tau += COULOMB * np.sign(dq)
        stamps = start_ns + np.round(t * 1e9).astype(np.int64)
        write_messages(path, joint_messages(stamps, JOINTS, q, effort=tau), encoding="cdr")
    known = known_model(robot, 1.02)
    file = with_stage(None, robot_id(robot), [], friction=known.friction, inertia=known.inertia)
    write_json_atomic(folder / "model.json", file)
    return folder


def assert_same_tables(own: Path, other: Path) -> None:
    found, expected = pq.read_table(own), pq.read_table(other)
    assert found.schema == expected.schema
    for name in found.column_names:
        values, wanted = (table[name].to_numpy() for table in (found, expected))
        if wanted.dtype == np.float64:
            scale = np.nanmax(np.abs(wanted))
            np.testing.assert_allclose(values, wanted, rtol=0.0, atol=1e-9 * scale, err_msg=name)
        else:
            np.testing.assert_array_equal(values, wanted, err_msg=name)


def assert_same_errors(own: Path, other: Path) -> None:
    found, expected = (json.loads(path.read_text()) for path in (own, other))
    logs = zip(found.pop("logs"), expected.pop("logs"), strict=True)
    for log, wanted in [*logs, (found, expected)]:
        for joint, errors in wanted.pop("joints").items():
            assert log["joints"][joint] == pytest.approx(errors, rel=1e-6), joint
    assert found["stages"] == expected["stages"]
    assert found["inputs"] == expected["inputs"]


def test_a_log_that_is_passed_over_gives_the_same_files(
    folder: Path, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = [str(folder / name) for name in LOGS]
    parts: list[LogPrediction] = []
    passed = LongPrediction.__iter__

    def watched(long: LongPrediction) -> Iterator[LogPrediction]:
        for part in passed(long):
            parts.append(part)
            yield part

    monkeypatch.setattr(LongPrediction, "__iter__", watched)

    def predict(name: str) -> None:
        inputs = ["-r", str(folder / "robot.toml"), "-p", str(folder / "model.json")]
        outputs = ["-o", f"{name}.json", "--torques", f"{name}.parquet"]
        done = rig.run("predict", *logs, *inputs, *outputs, "--cutoff", "20")
        assert done.code == 0, done.err

    predict("held")
    assert not parts
    monkeypatch.setattr(equations, "LONG", 5_000)
    monkeypatch.setattr(LongPrediction, "rows", 1_500)
    monkeypatch.setattr(blocks, "LEAST_BLOCK", 2_000)
    predict("long")
    assert len(parts) > 1
    assert_same_errors(rig.folder / "long.json", rig.folder / "held.json")
    assert_same_tables(rig.folder / "long.parquet", rig.folder / "held.parquet")
