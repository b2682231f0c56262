"""Parquet logs: names, types, lists, episodes that are never joined, missing values,
damage.
"""

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.contents import contents_of
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.robot.types import Channels
from tests.unit.logs import samples
from tests.unit.logs.format_writers import Data, lerobot_table
from tests.unit.logs.samples import (
    ARRAY,
    GYRO,
    JOINTS,
    curve,
    grid,
    make_motion,
    make_robot,
)

MOTION = make_motion(grid())
LISTS = pa.list_(pa.float32())
Table = pa.Table | dict[str, object]
COLUMNS: dict[str, object] = {
    "t": MOTION.t,
    **{f"{name}.position": MOTION.q[:, i] for i, name in enumerate(JOINTS)},
}
TORQUES = {f"{name}.torque": MOTION.tau[:, i] for i, name in enumerate(JOINTS)}
CURRENTS = {f"{name}.current": MOTION.dq[:, i] for i, name in enumerate(JOINTS)}


def read(folder: Path, columns: Table, channels: Channels | None = None) -> Recording:
    path = folder / "log.parquet"
    pq.write_table(pa.table(columns), path)
    imus = (ARRAY, GYRO)
    robot = make_robot(
        constants=[0.1, 0.2, 0.3], gear_ratio=10.0, channels=channels, imus=imus
    )
    return read_recording(path, robot)


def warned(recording: Recording, *words: str) -> bool:
    return any(
        all(word in text for word in words) for text in recording.health.warnings
    )


def test_default_names(tmp_path: Path) -> None:
    path = samples.write_motion(
        tmp_path / "log.parquet", MOTION, temperature=MOTION.q + 30.0
    )
    recording = read_recording(path, make_robot(imus=(ARRAY, GYRO)))
    found = (recording.q, recording.dq, recording.tau, recording.temperature)
    np.testing.assert_array_equal(
        found, (MOTION.q, MOTION.dq, MOTION.tau, MOTION.q + 30.0)
    )
    for imu, values in MOTION.accelerometers.items():
        np.testing.assert_array_equal(recording.accelerometers[imu], values)
    np.testing.assert_array_equal(recording.gyros["hand"], MOTION.gyros["hand"])
    assert recording.valid.all()
    assert (recording.format, recording.partial) == ("parquet", "")
    assert len(recording.sha256) == 64


START_S = 1_700_000_000
NS = np.rint(MOTION.t * 1e9).astype(np.int64)
EPOCH_NS = NS + START_S * 10**9
TIMES: list[object] = [
    MOTION.t + START_S,
    pa.array(MOTION.t.astype(np.float32)),
    *(
        pa.array(EPOCH_NS // per, pa.timestamp(unit, zone))
        for unit, per in (("ns", 1), ("us", 10**3), ("ms", 10**6))
        for zone in (None, "Asia/Tokyo")
    ),
    pa.array(NS // 10**3, pa.duration("us")),
    pa.array((NS // 10**6).astype(np.int32), pa.time32("ms")),
    EPOCH_NS,
    EPOCH_NS // 10**6,
    (EPOCH_NS / 10**3).astype(np.float64),
]


@pytest.mark.parametrize("time", TIMES)
def test_every_form_of_time(tmp_path: Path, time: object) -> None:
    recording = read(tmp_path, COLUMNS | {"t": time})
    np.testing.assert_allclose(recording.t, MOTION.t, atol=2e-6)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=2e-6)


def test_coarse_time_and_rows_without_time_are_told(tmp_path: Path) -> None:
    t = (MOTION.t + 40_000.0).astype(np.float32)
    assert warned(read(tmp_path, COLUMNS | {"t": t}), "0.00391 s", "float64")
    some: list[float | None] = list(MOTION.t)
    some[10], some[11] = None, float("nan")
    recording = read(tmp_path, COLUMNS | {"t": pa.array(some, pa.float64())})
    assert warned(recording, "2 rows without")
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-5)


def test_integer_decimal_and_nested_columns(tmp_path: Path) -> None:
    counts = np.arange(len(MOTION.t))
    shoulder = pa.array(counts.astype(float)).dictionary_encode()
    wrist = pa.array(counts.astype(float)).cast(pa.decimal128(9, 2))
    columns = {"t": MOTION.t, "elbow": [{"position": int(k)} for k in counts]}
    columns |= {"wrist": pa.StructArray.from_arrays([wrist], ["position"])}
    columns |= {"shoulder.position": shoulder}
    np.testing.assert_array_equal(
        read(tmp_path, columns).q, np.tile(counts[:, None], (1, 3))
    )


TWICE = pa.StructArray.from_arrays([pa.array(MOTION.t)] * 2, ["position"] * 2)
OTHERS = "neither torque nor current of joint shoulder, wrist, but of others"


@pytest.mark.parametrize(
    ("more", "channels", "message"),
    [
        *(
            ({"elbow.position": [value] * 200}, None, "elbow.position")
            for value in ("a", dt.date(2026, 1, 1), [1.0], True)
        ),
        (
            {"elbow.position": None, "Elbow.positions": MOTION.t},
            None,
            "Elbow.positions",
        ),
        ({"elbow": TWICE}, None, "'elbow.position' is there"),
        ({}, Channels(current="i_{index}"), "'i_1'"),
        ({"elbow.torque": MOTION.t}, None, OTHERS),
        (
            dict.fromkeys(COLUMNS, pa.array([], pa.float64())),
            None,
            ": 0 samples, all without it",
        ),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, more: dict[str, object], channels: Channels | None, message: str
) -> None:
    columns = {name: own for name, own in (COLUMNS | more).items() if own is not None}
    with pytest.raises(InputError) as caught:
        read(tmp_path, columns, channels)
    assert message in caught.value.message
    assert caught.value.hint
    assert caught.value.where == str(tmp_path / "log.parquet")


@pytest.mark.parametrize(
    ("channels", "from_current"),
    [
        (None, False),
        (Channels(current="{name}.current"), True),
        (Channels(current="{name}.current", torque="{name}.torque"), False),
    ],
)
def test_torque_wins_unless_current_is_declared(
    tmp_path: Path, channels: Channels | None, from_current: bool
) -> None:
    recording = read(tmp_path, COLUMNS | TORQUES | CURRENTS, channels)
    expected = MOTION.dq * [1.0, 2.0, 3.0] if from_current else MOTION.tau
    np.testing.assert_allclose(recording.tau, expected)
    assert read(tmp_path, COLUMNS).tau is None


FORMS = [
    (f"hand{mark}a{{}}", f"hand{mark}g{{}}", ends)
    for mark in "./_"
    for ends in ("xyz", "123")
]
FORMS += [
    (
        f"{stem}linear_acceleration{stem[-1]}{{}}",
        f"{stem}angular_velocity{stem[-1]}{{}}",
        "xyz",
    )
    for stem in ("hand.", "hand/", "/hand/data/")
]


@pytest.mark.parametrize(("accelerometer", "gyro", "ends"), FORMS)
def test_names_of_imus(
    tmp_path: Path, accelerometer: str, gyro: str, ends: str
) -> None:
    a, w = MOTION.accelerometers["hand"], MOTION.gyros["hand"]
    columns = COLUMNS | {
        accelerometer.format(end): a[:, k] for k, end in enumerate(ends)
    }
    columns |= {gyro.format(axis): w[:, k] for k, axis in enumerate("xyz")}
    recording = read(tmp_path, columns)
    assert list(recording.accelerometers) == ["hand"]
    np.testing.assert_array_equal(recording.accelerometers["hand"], a)
    np.testing.assert_array_equal(recording.gyros["hand"], w)


@pytest.mark.parametrize("dropped", ["array.a3", "hand.az", "hand.gx"])
def test_half_an_imu_names_the_columns(tmp_path: Path, dropped: str) -> None:
    path = samples.write_motion(tmp_path / "log.parquet", MOTION)
    pq.write_table(pq.read_table(path).drop_columns([dropped]), path)
    with pytest.raises(InputError, match=dropped):
        read_recording(path, make_robot(imus=(ARRAY, GYRO)))
    assert read(tmp_path, COLUMNS).accelerometers == {}


def test_missing_values_are_bridged_or_marked(tmp_path: Path) -> None:
    elbow: list[float | None] = list(MOTION.q[:, 1])
    elbow[20:22] = [None, float("nan")]
    elbow[100:130] = [None] * 30
    recording = read(
        tmp_path, COLUMNS | {"elbow.position": pa.array(elbow, pa.float64())}
    )
    np.testing.assert_array_equal(np.flatnonzero(~recording.valid), np.arange(100, 130))
    valid = recording.valid
    np.testing.assert_allclose(recording.q[valid], MOTION.q[valid], atol=1e-6)
    np.testing.assert_allclose(recording.health.gaps, [(0.99, 1.30)], atol=1e-9)


def test_optional_channel_of_some_joints(tmp_path: Path) -> None:
    own = MOTION.q[:, 1]
    names = ("velocity", "load", "temperature")
    recording = read(tmp_path, COLUMNS | {f"elbow.{name}": own for name in names})
    for name in ("velocity", "load"):
        assert warned(
            recording, f"{name} is logged for some joints only; it is left out"
        )
    assert recording.dq is recording.load is None
    assert recording.valid.all()
    assert np.isnan(recording.temperature[:, [0, 2]]).all()
    np.testing.assert_array_equal(recording.temperature[:, 1], own)


@pytest.mark.parametrize("at", [slice(-40, -20), slice(-8, -4), slice(4, 400)])
def test_damaged_footer_and_pages(tmp_path: Path, at: slice) -> None:
    path = samples.write_motion(tmp_path / "log.parquet", MOTION)
    data = bytearray(path.read_bytes())
    data[at] = b"\xff" * len(data[at])
    path.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_recording(path, make_robot())


def episode(shift: float, count: int = 200) -> Data:
    t = MOTION.t[:count]
    q = curve(t, 3, shift)
    return Data(t, JOINTS, q, q, q, 10.0 * q)


def test_episodes_become_stretches_with_gaps(tmp_path: Path) -> None:
    episodes = [episode(0.0), episode(5.0, 60), episode(9.0, 90)]
    recording = read(tmp_path, lerobot_table(episodes))
    assert warned(recording, "3 episodes")
    found = runs(recording.valid, len(recording.t))
    assert [end - start for start, end in found] == [200, 60, 90]
    for (start, end), data in zip(found, episodes, strict=True):
        np.testing.assert_allclose(recording.q[start:end], data.q, atol=2e-5)
    assert [end - start > 1.0 for start, end in recording.health.gaps] == [True, True]


def test_rows_without_an_episode_are_left_out(tmp_path: Path) -> None:
    recording = read(tmp_path, COLUMNS | {"episode_index": [0] * 180 + [None] * 20})
    assert len(recording.t) == 180
    assert warned(recording, "20 rows without episode_index")


def read_set(folder: Path, names: object, length: int) -> Recording:
    """Read a data set that names the motors;
    the last of `length` values is a gripper.
    """
    info = folder / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text(json.dumps({"features": {"observation.state": {"names": names}}}))
    states = pa.array(list(curve(MOTION.t, length).astype(np.float32)), LISTS)
    table = {"observation.state": states, "timestamp": MOTION.t.astype(np.float32)}
    (folder / "data" / "chunk-000").mkdir(parents=True)
    return read(folder / "data" / "chunk-000", table)


ORDER = [1, 3, 0]  # of the joints among the motors
MOTORS = ["wrist", "shoulder", "gripper", "elbow"]


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        ([f"{name}.pos" for name in MOTORS], ORDER),
        ({"motors": MOTORS}, ORDER),
        *(
            (names, [0, 1, 2])
            for names in (None, 7, ["a", "b"], [["a"]], {"x": [], "y": []})
        ),
    ],
)
def test_joints_are_matched_by_names(
    tmp_path: Path, names: object, columns: list[int]
) -> None:
    recording = read_set(tmp_path, names, 4)
    np.testing.assert_allclose(recording.q, curve(MOTION.t, 4)[:, columns], atol=1e-6)
    assert warned(recording, "in the order of the robot file") == (columns != ORDER)


def test_lists_of_another_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no column 'observation\.state\[2\]'"):
        read_set(tmp_path, None, 2)
    rows = [row.tolist() for row in MOTION.q]
    rows[17] = rows[17][:2]
    table = {"t": MOTION.t, "observation.state": pa.array(rows, LISTS)}
    with pytest.raises(
        InputError, match=r"row 18: 'observation\.state' holds 2 values"
    ) as caught:
        read(tmp_path, table)
    assert caught.value.hint


@pytest.mark.parametrize(
    "kind", [LISTS, pa.list_(pa.float64(), 3), pa.large_list(pa.float64())]
)
def test_missing_lists_and_values(tmp_path: Path, kind: pa.DataType) -> None:
    rows: list[object] = [row.tolist() for row in MOTION.q]
    rows[0] = None
    rows[40] = [None, *MOTION.q[40, 1:].tolist()]
    rows[60] = [float("nan")] * 3
    recording = read(tmp_path, {"t": MOTION.t, "q": pa.array(rows, kind)})
    assert len(recording.t) == 199
    np.testing.assert_allclose(recording.q, MOTION.q[1:], atol=2e-5)


def test_joint_state_messages_in_a_table(tmp_path: Path) -> None:
    names = ["wrist", "elbow", "shoulder"]
    rows = {"timestamp": MOTION.t, "name": [names] * 200, "velocity": [[]] * 200}
    rows |= {"position": list(MOTION.q[:, ::-1]), "effort": list(MOTION.tau[:, ::-1])}
    recording = read(tmp_path, rows)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    assert recording.dq is None
    rows["name"] = [names] * 100 + [names[::-1]] * 100
    with pytest.raises(InputError, match="change from row to row"):
        read(tmp_path, rows)


MIXED = [f"{name}.{kind}" for name in MOTORS for kind in ("pos", "vel", "torque")]


def mixed_states() -> dict[str, np.ndarray]:
    """What a robot with torque feedback lists, by the names of its motors."""
    rng = np.random.default_rng(4)
    values = curve(MOTION.t, len(MIXED)) + rng.normal(size=len(MIXED))
    return dict(zip(MIXED, values.astype(np.float32).T, strict=True))


def read_mixed(folder: Path, names: list[str], channels: Channels) -> Recording:
    info = folder / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text(json.dumps({"features": {"observation.state": {"names": names}}}))
    states = np.column_stack(list(mixed_states().values()))
    table = {"observation.state": list(states), "action": list(states)}
    (folder / "data").mkdir(parents=True)
    path = folder / "data" / "log.parquet"
    pq.write_table(pa.table(table | {"timestamp": MOTION.t}), path)
    return read_recording(path, make_robot(channels=channels))


def test_a_lerobot_state_of_several_kinds(tmp_path: Path) -> None:
    recording = read_mixed(tmp_path, MIXED, Channels(unit="deg"))
    states = mixed_states()
    for j, joint in enumerate(JOINTS):
        np.testing.assert_allclose(
            recording.q[:, j], np.deg2rad(states[f"{joint}.pos"]), atol=1e-9
        )
        np.testing.assert_allclose(
            recording.dq[:, j], np.deg2rad(states[f"{joint}.vel"]), atol=1e-9
        )
        np.testing.assert_array_equal(recording.tau[:, j], states[f"{joint}.torque"])
    contents = contents_of(tmp_path / "data" / "log.parquet")
    assert contents.joints == tuple(MOTORS)


def test_joints_of_a_mixed_state_are_never_taken_by_their_order(tmp_path: Path) -> None:
    """The second entry of the state is no second joint."""
    names = [name.replace("elbow", "elbow_flex") for name in MIXED]
    with pytest.raises(InputError, match="no joint elbow; names in the log: wrist,"):
        read_mixed(tmp_path / "as it is", names, Channels())
    channels = Channels(names=("shoulder", "elbow_flex", "wrist"))
    recording = read_mixed(tmp_path / "named", names, channels)
    np.testing.assert_allclose(recording.q[:, 1], mixed_states()["elbow.pos"])
