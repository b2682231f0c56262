"""Parquet logs: names, types, missing values, damage."""

import datetime as dt
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.types import Channels, Robot
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot, write_motion
from tests.unit.logs.writers import write_parquet

MOTION = make_motion(grid())
Columns = dict[str, object]


def default_columns() -> Columns:
    columns: Columns = {"t": MOTION.t}
    return columns | {f"{name}.position": MOTION.q[:, i] for i, name in enumerate(JOINTS)}


def write(path: Path, columns: Columns) -> Path:
    pq.write_table(pa.table(columns), path)
    return path


def test_default_names(tmp_path: Path) -> None:
    path = write_motion(tmp_path / "log.parquet", MOTION, temperature=MOTION.q + 30.0)
    recording = read_recording(path, make_robot(imus=(ARRAY, GYRO)))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.dq is not None
    assert recording.tau is not None
    assert recording.temperature is not None
    np.testing.assert_array_equal(recording.dq, MOTION.dq)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    np.testing.assert_array_equal(recording.temperature, MOTION.q + 30.0)
    np.testing.assert_array_equal(recording.accelerometers["array"], MOTION.accelerometers["array"])
    np.testing.assert_array_equal(recording.accelerometers["hand"], MOTION.accelerometers["hand"])
    np.testing.assert_array_equal(recording.gyros["hand"], MOTION.gyros["hand"])
    assert recording.valid.all()
    assert (recording.format, recording.partial) == ("parquet", "")
    assert len(recording.sha256) == 64


@pytest.mark.parametrize(
    ("pattern", "name"),
    [("q_{index}", "q_{0}"), ("actual_q_{index0}", "actual_q_{1}"), ("{name}/pos", "{2}/pos")],
)
def test_patterns_of_the_robot_file(tmp_path: Path, pattern: str, name: str) -> None:
    columns: Columns = {"stamp": MOTION.t}
    for i, joint in enumerate(JOINTS):
        columns[name.format(i + 1, i, joint)] = MOTION.q[:, i]
    path = write(tmp_path / "log.parquet", columns)
    channels = Channels(time="stamp", position=pattern)
    np.testing.assert_array_equal(read_recording(path, make_robot(channels=channels)).q, MOTION.q)


def numeric_time() -> list[object]:
    start = 1_700_000_000
    whole = np.rint(MOTION.t * 1e9).astype(np.int64) + start * 10**9
    return [
        MOTION.t + start,
        pa.array(MOTION.t.astype(np.float32)),
        *(
            pa.array(whole // per, pa.timestamp(unit, zone))
            for unit, per in (("ns", 1), ("us", 10**3), ("ms", 10**6))
            for zone in (None, "Asia/Tokyo")
        ),
        pa.array((whole - start * 10**9) // 10**3, pa.duration("us")),
        pa.array(((whole - start * 10**9) // 10**6).astype(np.int32), pa.time32("ms")),
        whole,
        whole // 10**6,
        (whole / 10**3).astype(np.float64),
    ]


@pytest.mark.parametrize("time", numeric_time())
def test_every_form_of_time(tmp_path: Path, time: object) -> None:
    path = write(tmp_path / "log.parquet", default_columns() | {"t": time})
    recording = read_recording(path, make_robot())
    np.testing.assert_allclose(recording.t, MOTION.t, atol=2e-6)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=2e-6)


def test_coarse_float_time_is_told_with_its_step(tmp_path: Path) -> None:
    t = (MOTION.t + 40_000.0).astype(np.float32)
    path = write(tmp_path / "log.parquet", default_columns() | {"t": t})
    warnings = read_recording(path, make_robot()).health.warnings
    assert any("0.00391 s" in warning and "float64" in warning for warning in warnings)


def test_rows_without_time_are_left_out(tmp_path: Path) -> None:
    t: list[float | None] = list(MOTION.t)
    t[10], t[11] = None, float("nan")
    path = write(tmp_path / "log.parquet", default_columns() | {"t": pa.array(t, pa.float64())})
    recording = read_recording(path, make_robot())
    assert any("2 rows without" in warning for warning in recording.health.warnings)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-5)


def test_integer_and_decimal_columns(tmp_path: Path) -> None:
    counts = np.arange(len(MOTION.t))
    columns = default_columns() | {
        "elbow.position": counts.astype(np.int16),
        "wrist.position": pa.array(counts.astype(float)).cast(pa.decimal128(9, 2)),
        "shoulder.position": pa.array(counts.astype(float)).dictionary_encode(),
    }
    recording = read_recording(write(tmp_path / "log.parquet", columns), make_robot())
    np.testing.assert_array_equal(recording.q, np.tile(counts[:, None], (1, 3)))


def test_nested_columns(tmp_path: Path) -> None:
    rows = [
        {"t": t, **{name: {"position": q[i]} for i, name in enumerate(JOINTS)}}
        for t, q in zip(MOTION.t, MOTION.q, strict=True)
    ]
    path = tmp_path / "log.parquet"
    pq.write_table(pa.Table.from_pylist(rows), path)
    np.testing.assert_array_equal(read_recording(path, make_robot()).q, MOTION.q)


@pytest.mark.parametrize(
    "values", [["a"] * 200, [dt.date(2026, 1, 1)] * 200, [[1.0]] * 200, [True] * 200]
)
def test_column_that_is_no_number(tmp_path: Path, values: list[object]) -> None:
    path = write(tmp_path / "log.parquet", default_columns() | {"elbow.position": values})
    with pytest.raises(InputError, match=r"elbow\.position"):
        read_recording(path, make_robot())


def test_missing_position_names_the_nearest(tmp_path: Path) -> None:
    columns = default_columns()
    columns["Elbow.positions"] = columns.pop("elbow.position")
    path = write(tmp_path / "log.parquet", columns)
    with pytest.raises(InputError) as caught:
        read_recording(path, make_robot())
    assert "'elbow.position'" in caught.value.message
    assert "Elbow.positions" in caught.value.message
    assert caught.value.where == str(path)


def test_declared_column_must_exist(tmp_path: Path) -> None:
    path = write(tmp_path / "log.parquet", default_columns())
    with pytest.raises(InputError, match="'i_1'"):
        read_recording(path, make_robot(channels=Channels(current="i_{index}")))


def with_both(tmp_path: Path) -> Path:
    return write_parquet(
        tmp_path / "log.parquet", MOTION.t, JOINTS, MOTION.q, current=MOTION.dq, torque=MOTION.tau
    )


@pytest.mark.parametrize(
    ("channels", "from_current"),
    [
        (Channels(), False),
        (Channels(current="{name}.current"), True),
        (Channels(current="{name}.current", torque="{name}.torque"), False),
    ],
)
def test_torque_wins_unless_current_is_declared(
    tmp_path: Path, channels: Channels, from_current: bool
) -> None:
    robot = make_robot(constants=[0.1, 0.2, 0.3], gear_ratio=10.0, channels=channels)
    recording = read_recording(with_both(tmp_path), robot)
    expected = MOTION.dq * [1.0, 2.0, 3.0] if from_current else MOTION.tau
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, expected)


def test_no_torque_at_all_and_torque_of_some(tmp_path: Path) -> None:
    path = write(tmp_path / "log.parquet", default_columns())
    assert read_recording(path, make_robot()).tau is None
    path = write(tmp_path / "log.parquet", default_columns() | {"elbow.torque": MOTION.q[:, 0]})
    with pytest.raises(InputError, match="neither torque nor current of joint shoulder, wrist"):
        read_recording(path, make_robot())


@pytest.mark.parametrize("dropped", ["array.a3", "hand.az", "hand.gx"])
def test_half_an_imu_names_the_columns(tmp_path: Path, dropped: str) -> None:
    robot: Robot = make_robot(imus=(ARRAY, GYRO))
    path = write_motion(tmp_path / "log.parquet", MOTION)
    table = pq.read_table(path)
    pq.write_table(table.drop_columns([dropped]), path)
    with pytest.raises(InputError, match=dropped):
        read_recording(path, robot)
    pq.write_table(
        table.select([n for n in table.column_names if "." not in n or "pos" in n]), path
    )
    assert read_recording(path, robot).accelerometers == {}


def test_missing_values_are_bridged_or_marked(tmp_path: Path) -> None:
    elbow: list[float | None] = list(MOTION.q[:, 1])
    elbow[20:22] = [None, float("nan")]
    elbow[100:130] = [None] * 30
    columns = default_columns() | {"elbow.position": pa.array(elbow, pa.float64())}
    recording = read_recording(write(tmp_path / "log.parquet", columns), make_robot())
    invalid = np.zeros(200, np.bool_)
    invalid[100:130] = True
    np.testing.assert_array_equal(recording.valid, ~invalid)
    np.testing.assert_allclose(recording.q[~invalid], MOTION.q[~invalid], atol=1e-6)
    np.testing.assert_allclose(recording.health.gaps, [(0.99, 1.30)], atol=1e-9)


@pytest.mark.parametrize("quantity", ["velocity", "temperature"])
def test_optional_channel_of_some_joints(tmp_path: Path, quantity: str) -> None:
    path = write(
        tmp_path / "log.parquet", default_columns() | {f"elbow.{quantity}": MOTION.q[:, 1]}
    )
    recording = read_recording(path, make_robot())
    assert recording.dq is None
    assert recording.valid.all()
    if quantity == "temperature":
        assert np.isnan(recording.temperature[:, [0, 2]]).all()
        np.testing.assert_array_equal(recording.temperature[:, 1], MOTION.q[:, 1])


def test_damaged_footer_and_pages(tmp_path: Path) -> None:
    path = with_both(tmp_path)
    whole = path.read_bytes()
    for at in (slice(-40, -20), slice(-8, -4), slice(4, 400)):
        data = bytearray(whole)
        data[at] = b"\xff" * len(data[at])
        path.write_bytes(data)
        with pytest.raises(InputError, match="damaged"):
            read_recording(path, make_robot())


def test_empty_table_and_repeated_column(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    columns = {name: [] for name in default_columns()}
    pq.write_table(pa.table({k: pa.array(v, pa.float64()) for k, v in columns.items()}), path)
    with pytest.raises(InputError):
        read_recording(path, make_robot())
    arrays = [pa.array(MOTION.t)] * 5
    pq.write_table(
        pa.table(
            arrays,
            names=["t", "t", *default_columns()][:2] + [f"{name}.position" for name in JOINTS],
        ),
        path,
    )
    with pytest.raises(InputError, match="2 times"):
        read_recording(path, make_robot())
