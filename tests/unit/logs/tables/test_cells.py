"""Tables whose cells are more than numbers: texts, lists, times of the day."""

import datetime as dt
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.contents import contents_of
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.files import expand
from seqid_cli.robot.types import Channels
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot

MOTION = make_motion(grid(200))
T0_NS = 1_772_000_000_123_000_000
STAMPS_NS = (T0_NS + np.rint(MOTION.t * 1e9).astype(np.int64)).tolist()
ORDER = (2, 0, 1)  # of the joints in the messages
NAMES = [JOINTS[j] for j in ORDER]


def values(row: int, *, velocity: bool = True) -> list[str]:
    arrays = [MOTION.q, *([MOTION.dq] if velocity else []), MOTION.tau]
    return [repr(float(array[row, j])) for array in arrays for j in ORDER]


def rostopic(names: Sequence[str] = NAMES) -> str:
    """Print messages as `rostopic echo -p` does."""
    head = ["%time", *(f"field.header.{name}" for name in ("seq", "stamp", "frame_id"))]
    for array in ("name", "position", "velocity", "effort"):
        head += [f"field.{array}{k}" for k in range(3)]
    lines = [",".join(head)]
    for row, ns in enumerate(STAMPS_NS):
        received_ns = ns + 1_000_000 * (row % 7)  # on another clock, which jitters
        fields = [str(received_ns), str(row), str(ns), "", *names, *values(row)]
        lines.append(",".join(fields))
    return "\n".join(lines) + "\n"


def ros2(names: Sequence[str] = NAMES, *, velocity: bool = True) -> str:
    """Print messages as `ros2 topic echo --csv` does."""
    lines = []
    for row, ns in enumerate(STAMPS_NS):
        stamp = [str(ns // 10**9), str(ns % 10**9)]
        fields = values(row, velocity=velocity)
        if not velocity:  # an empty array is an empty field
            fields.insert(3, "")
        lines.append(",".join([*stamp, "base", *names, *fields]))
    return "\n".join(lines) + "\n"


def read(folder: Path, text: str, channels: Channels | None = None) -> Recording:
    path = folder / "log.csv"
    path.write_text(text)
    return read_recording(path, make_robot(channels=channels))


@pytest.mark.parametrize("echo", [rostopic, ros2])
def test_messages_printed_as_text(tmp_path: Path, echo: Callable[[], str]) -> None:
    recording = read(tmp_path, echo())
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.dq, MOTION.dq)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)
    assert recording.start == pytest.approx(T0_NS * 1e-9, abs=1e-6)
    assert recording.health.warnings == ()
    assert contents_of(tmp_path / "log.csv").joints == tuple(NAMES)
    assert expand([str(tmp_path)]) == [tmp_path / "log.csv"]  # found in a folder


def test_empty_arrays_of_a_message(tmp_path: Path) -> None:
    recording = read(tmp_path, ros2(velocity=False))
    assert recording.dq is None
    np.testing.assert_array_equal(recording.tau, MOTION.tau)


def test_columns_of_messages_by_number(tmp_path: Path) -> None:
    channels = Channels(time=1, position=(7, 8, 9), torque=(13, 14, 15))
    recording = read(tmp_path, ros2(), channels)
    np.testing.assert_array_equal(recording.q, MOTION.q[:, ORDER])
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)


@pytest.mark.parametrize("echo", [rostopic, ros2])
def test_messages_of_other_joints_are_refused(
    tmp_path: Path, echo: Callable[[Sequence[str]], str]
) -> None:
    with pytest.raises(InputError, match="no joint shoulder, elbow, wrist; names in"):
        read(tmp_path, echo(["a", "b", "c"]))
    two = echo(NAMES).splitlines()
    two[50:] = echo(list(JOINTS)).splitlines()[50:]
    with pytest.raises(InputError, match="change from row to row: 'wrist', 'shoulder'"):
        read(tmp_path, "\n".join(two) + "\n")


def test_texts_above_numbers_are_names(tmp_path: Path) -> None:
    """A column of texts makes no line of names a line of data."""
    head = ",".join(["t", "mode", *(f"{joint}.position" for joint in JOINTS)])
    lines = [
        f"{t!r},moving,{','.join(map(repr, q))}"
        for t, q in zip(MOTION.t.tolist(), MOTION.q.tolist(), strict=True)
    ]
    recording = read(tmp_path, "\n".join([head, *lines, ""]))
    np.testing.assert_array_equal(recording.q, MOTION.q)


def as_json(row: Sequence[float]) -> str:
    return json.dumps(list(row))


def as_tuple(row: Sequence[float]) -> str:
    return str(tuple(row))


def as_array(row: Sequence[float]) -> str:
    return "[" + "  ".join(map(repr, row)) + "]"


@pytest.mark.parametrize("write", [as_json, as_tuple, as_array])
def test_lists_in_cells(
    tmp_path: Path, write: Callable[[Sequence[float]], str]
) -> None:
    head = "time,name,position,effort"
    names = str(NAMES)
    lines = [
        f'{t!r},"{names}","{write([q[j] for j in ORDER])}",'
        f'"{write([tau[j] for j in ORDER])}"'
        for t, q, tau in zip(
            MOTION.t.tolist(), MOTION.q.tolist(), MOTION.tau.tolist(), strict=True
        )
    ]
    recording = read(tmp_path, "\n".join([head, *lines, ""]))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)


def json_lists(*, changed: dict[int, str]) -> str:
    lines = ["t,q"]
    for row, (t, q) in enumerate(zip(MOTION.t.tolist(), MOTION.q, strict=True)):
        lines.append(f'{t!r},"{changed.get(row, as_json(q.tolist()))}"')
    return "\n".join([*lines, ""])


def test_missing_values_of_lists_in_cells(tmp_path: Path) -> None:
    rest = MOTION.q[40, 1:].tolist()
    changed = {40: f"[null, {rest[0]!r}, {rest[1]!r}]", 60: "[NaN, NaN, NaN]", 80: ""}
    recording = read(tmp_path, json_lists(changed=changed))
    assert len(recording.t) == 200
    np.testing.assert_allclose(recording.q, MOTION.q, atol=2e-5)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("[1.0, 2.0]", "row 51: the list in column 'q' has 2 values, the first 3"),
        ("[1.0, 2.0, x]", "the lists in column 'q' are not of numbers"),
        ("[" * 5000 + "1, 2, [3" + "]" * 5000, "the lists in column 'q' are not of"),
    ],
)
def test_cells_that_are_no_such_lists_are_refused(
    tmp_path: Path, cell: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, json_lists(changed={50: cell}))
    assert message in caught.value.message
    assert caught.value.hint


START = dt.datetime(2026, 3, 1, 23, 59, 59, 500_000, tzinfo=dt.UTC)
CLOCK = [START + dt.timedelta(seconds=float(t)) for t in MOTION.t]  # over midnight
TIMES = {
    "%H:%M:%S.%f": 1e-6,
    "%H:%M:%S,%f": 1e-6,
    "%Y-%m-%dT%H:%M:%S.%f": 1e-6,
    "%Y-%m-%dT%H:%M:%S.%fZ": 1e-6,
    "%Y-%m-%dT%H:%M:%S.%f+01:00": 1e-6,
    "%Y-%m-%d %H:%M:%S.%f": 1e-6,
}


@pytest.mark.parametrize("form", TIMES)
def test_times_as_people_write_them(tmp_path: Path, form: str) -> None:
    head = ";".join(["time", *(f"{joint}.position" for joint in JOINTS)])
    lines = [
        ";".join([moment.strftime(form), *map(repr, q)])
        for moment, q in zip(CLOCK, MOTION.q.tolist(), strict=True)
    ]
    recording = read(tmp_path, "\n".join([head, *lines, ""]))
    np.testing.assert_allclose(recording.t, MOTION.t, atol=TIMES[form])
    np.testing.assert_array_equal(recording.q, MOTION.q)


def test_whole_seconds_of_the_day(tmp_path: Path) -> None:
    """A slow log, whose hours have one digit."""
    lines = ["time;shoulder.position;elbow.position;wrist.position"]
    for row in range(200):
        hours, seconds = divmod(9 * 3600 - 100 + row, 3600)
        minutes, seconds = divmod(seconds, 60)
        q = ";".join(map(repr, MOTION.q[row].tolist()))
        lines.append(f"{hours}:{minutes:02d}:{seconds:02d};{q}")
    recording = read(tmp_path, "\n".join([*lines, ""]))
    assert recording.rate_hz == pytest.approx(1.0)
    np.testing.assert_array_equal(recording.q, MOTION.q)


def test_a_time_that_is_none_is_named(tmp_path: Path) -> None:
    lines = ["time;shoulder.position;elbow.position;wrist.position"]
    lines += [f"12:00:{k:02d}.5;0.1;0.2;0.3" for k in range(50)]
    lines[30] = "12:61:00.5;0.1;0.2;0.3"
    with pytest.raises(InputError, match=r"'12:61:00\.5' is no time of the day"):
        read(tmp_path, "\n".join([*lines, ""]))


@pytest.mark.parametrize("struct", ["joint_states", "arm"])
@pytest.mark.parametrize(
    "kind", [pa.list_(pa.float64()), pa.list_(pa.float64(), 3)], ids=str
)
def test_lists_in_structs(tmp_path: Path, struct: str, kind: pa.DataType) -> None:
    arrays = [
        pa.array([NAMES] * 200, pa.list_(pa.string())),
        pa.array(MOTION.q[:, ORDER].tolist(), kind),
        pa.array(MOTION.tau[:, ORDER].tolist(), kind),
    ]
    message = pa.StructArray.from_arrays(arrays, ["name", "position", "effort"])
    table = {"timestamp": pa.array(MOTION.t), struct: message}
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table(table), path)
    if struct == "joint_states":
        recording = read_recording(path, make_robot())
        np.testing.assert_array_equal(recording.q, MOTION.q)
    else:
        channels = Channels(
            position="arm.position[{index0}]", torque="arm.effort[{index0}]"
        )
        recording = read_recording(path, make_robot(channels=channels))
        np.testing.assert_array_equal(recording.q, MOTION.q[:, ORDER])
    assert recording.tau is not None
