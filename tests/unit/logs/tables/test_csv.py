"""CSV logs: every way of writing them, and what is wrong with them."""

import datetime as dt
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.files import check_log
from seqid_cli.robot.types import Channels, Imu
from tests import Array
from tests.unit.logs.format_writers import Data, csv_rtde
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot

MOTION = make_motion(grid())
NAMES = ["t", *(f"{name}.position" for name in JOINTS)]
TABLE = np.column_stack([MOTION.t, MOTION.q])
HEADER = ",".join(NAMES)


def lines(delimiter: str = ",", table: Array = TABLE) -> list[str]:
    return [delimiter.join(repr(float(v)) for v in row) for row in table]


ROWS = lines()


def text(rows: list[str], header: str = HEADER, end: str = "\n") -> bytes:
    return (end.join([header, *rows]) + end).encode()


def beside(more: str, header: str) -> bytes:
    return text([row + "," + more for row in ROWS], f"{HEADER},{header}")


def changed(column: int, words: dict[int, str]) -> list[str]:
    rows = [row.split(",") for row in ROWS]
    for row, word in words.items():
        rows[row][column] = word
    return [",".join(row) for row in rows]


def read(folder: Path, content: bytes, channels: Channels | None = None) -> Recording:
    (folder / "log.csv").write_bytes(content)
    return read_recording(folder / "log.csv", make_robot(channels=channels))


SPELLINGS = {
    f"{mark!r} {end!r} {bom!r}": text(lines(mark), bom + mark.join(NAMES), end)
    for mark, end, bom in product(",;\t ", ("\n", "\r\n"), ("", "\ufeff"))
}
for mark in ";\t ":
    commas = [row.replace(".", ",") for row in lines(mark)]
    SPELLINGS[f"decimal commas, {mark!r}"] = text(commas, mark.join(NAMES))
SPELLINGS |= {
    "comments": text(ROWS, f"# made by a logger\n#\n{HEADER}"),
    "names in a comment": text(ROWS, f"# {HEADER}"),
    "names in the last comment": text(ROWS, f"% one\n\n% {HEADER}"),
    "quotes": text(ROWS, ",".join(f'"{name}"' for name in NAMES)),
    "spaces": text(ROWS, ", ".join(NAMES)),
    "delimiter at the end": text([row + "," for row in ROWS]),
    "delimiter at the end of the names": text(
        [row + "," for row in ROWS], HEADER + ","
    ),
    "latin-1": beside("20", "temp [\xb0C]").decode().encode("latin-1"),
    "texts": beside("moving", "state"),
    "empty columns": beside(",0.1", "shoulder.velocity,gripper.position"),
}


@pytest.mark.parametrize("content", SPELLINGS.values(), ids=SPELLINGS)
def test_every_spelling_gives_the_same(tmp_path: Path, content: bytes) -> None:
    recording = read(tmp_path, content)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.dq is None
    assert (recording.format, recording.partial, recording.health.warnings) == (
        "csv",
        "",
        (),
    )


WORDS = ("", "nan", "NaN", "-nan", "null", "None", "inf", "1e400", "NA", "9" * 400)


@pytest.mark.parametrize("word", WORDS)
def test_missing_values_and_too_large_numbers(tmp_path: Path, word: str) -> None:
    recording = read(tmp_path, text(changed(2, {20: word, 50: word})))
    assert recording.valid.all()
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-6)
    assert recording.partial == ""
    infinite = any("infinite" in warning for warning in recording.health.warnings)
    assert infinite == (word in ("1e400", "9" * 400))


START = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
WHOLE_NS = (
    np.rint(MOTION.t * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
).tolist()
SECONDS = [repr(float(t)) for t in MOTION.t]
CLOCK = [START + dt.timedelta(seconds=float(t)) for t in MOTION.t]
TIMES = {
    **dict.fromkeys(["time", "__time", "Zeit [s]"], SECONDS),
    "Timestamp": [moment.strftime("%Y-%m-%d %H:%M:%S.%f") for moment in CLOCK],
    "time_ms": [str(round(t * 1e3)) for t in MOTION.t],
    "t_us": [str(round(t * 1e6)) for t in MOTION.t],
    "timestamp [ns]": [str(round(t * 1e9)) for t in MOTION.t],
    "header.stamp.sec,header.stamp.nanosec": [
        f"{ns // 10**9},{ns % 10**9}" for ns in WHOLE_NS
    ],
}


@pytest.mark.parametrize("name", TIMES)
def test_names_and_units_of_time(tmp_path: Path, name: str) -> None:
    rows = [
        f"{t},{row.split(',', 1)[1]}" for t, row in zip(TIMES[name], ROWS, strict=True)
    ]
    recording = read(tmp_path, text(rows, ",".join([name, *NAMES[1:]])))
    np.testing.assert_allclose(recording.t, MOTION.t, atol=2e-6)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-5)
    if "nanosec" in name:
        np.testing.assert_array_equal(recording.q, MOTION.q)
        assert recording.start == pytest.approx(1_700_000_000.0, abs=1e-6)


@pytest.mark.parametrize("pattern", ["a_{index}", "actual_q_{index0}", "{name}/pos"])
def test_names_of_the_robot_file_win(tmp_path: Path, pattern: str) -> None:
    each = (
        pattern.format(name=name, index=k + 1, index0=k)
        for k, name in enumerate(JOINTS)
    )
    content = text(
        [row + ",9.0" for row in ROWS], ",".join(["clock", *each, "shoulder.position"])
    )
    recording = read(tmp_path, content, Channels(time="clock", position=pattern))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    with pytest.raises(InputError, match="b_1"):
        read(tmp_path, content, Channels(time="clock", position="b_{index}"))


@pytest.mark.parametrize("torque", ["{}.torque", "effort.{}", "{}/tau"])
def test_what_the_robot_file_leaves_out_is_found_by_name(
    tmp_path: Path, torque: str
) -> None:
    header = ["t", "enc_0", "enc_1", "enc_2", *(torque.format(name) for name in JOINTS)]
    content = text(lines(table=np.column_stack([TABLE, MOTION.tau])), ",".join(header))
    recording = read(tmp_path, content, Channels(position="enc_{index0}"))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)


def test_rtde_with_its_own_accelerometer(tmp_path: Path) -> None:
    tool = Imu("tool", 2, np.zeros((3, 3)), np.eye(3))
    robot = make_robot(imus=(tool,), constants=0.1, gear_ratio=100.0)
    data = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)
    recording = read_recording(csv_rtde(tmp_path / "log", data), robot)
    np.testing.assert_allclose(recording.tau, 10.0 * MOTION.tau, rtol=1e-12)
    assert (recording.temperature == 31.5).all()
    assert recording.start == 1234.5
    np.testing.assert_array_equal(recording.accelerometers["tool"][7], [0.1, -0.2, 9.8])


def test_rtde_with_current_as_torque(tmp_path: Path) -> None:
    """The controller's own torque needs no data of the drives."""
    header = ["timestamp", *(f"actual_q_{i}" for i in range(3))]
    header += [f"actual_current_{i}" for i in range(3)]
    header += [f"actual_current_as_torque_{i}" for i in range(3)]
    table = np.column_stack([TABLE, MOTION.dq, MOTION.tau])
    recording = read(tmp_path, text(lines(table=table), ",".join(header)))
    np.testing.assert_array_equal(recording.tau, MOTION.tau)


def test_libfranka_names_with_time_in_seconds_are_noticed(tmp_path: Path) -> None:
    header = ",".join(["time", *(f"state.q[{i}]" for i in range(3))])
    recording = read(tmp_path, text(ROWS, header))
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-12)
    assert any("read as s" in warning for warning in recording.health.warnings)


def test_columns_without_names_are_read_by_their_numbers(tmp_path: Path) -> None:
    content = "\n".join([*ROWS, ""]).encode()
    with pytest.raises(
        InputError, match="has no line of names: its columns are numbered 1 to 4"
    ):
        read(tmp_path, content)
    for columns, order in (
        ((2, 3, 4), slice(None)),
        ((4, 3, 2), slice(None, None, -1)),
    ):
        recording = read(tmp_path, content, Channels(time=1, position=columns))
        np.testing.assert_array_equal(recording.q, MOTION.q[:, order])


def test_a_table_on_its_side_is_told(tmp_path: Path) -> None:
    lines = [",".join(f"{0.001 * i + j}" for i in range(500)) for j in range(4)]
    with pytest.raises(InputError, match="500 columns: samples seem to lie side") as e:
        read(tmp_path, "\n".join([*lines, ""]).encode())
    assert "Turn the table" in (e.value.hint or "")


def test_lines_left_out_are_told(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recording = read(tmp_path, text(ROWS)[:-5])
    np.testing.assert_array_equal(recording.q, MOTION.q[:-1])
    assert recording.partial == ""
    assert any("may be cut short" in warning for warning in recording.health.warnings)
    recording = read(tmp_path, text([*ROWS[:-1], ROWS[-1].split(",")[0] + ",0.1"]))
    assert len(recording.t) == 199
    assert (
        recording.partial
        == "line 201 has 2 fields, the header 4; 1 of 200 lines were left out"
    )
    parts = text(ROWS).split(b"\n")
    parts[20] = b"\xff\xfe\xbe"
    recording = read(tmp_path, b"\n".join(parts))
    assert recording.partial.startswith(
        "line 21 has 1 fields, the header 4; 1 of 200 lines"
    )
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-6)
    assert capfd.readouterr() == ("", "")


NUL = text(ROWS)[:3000] + b"\0" * 50 + text(ROWS)[3000:]
FAULT = "'fault' is no number"
REFUSED = [
    (text([row.replace(".", ",") for row in ROWS]), "decimal commas", "semicolons"),
    (
        text(changed(0, {99: "later"})),
        "line 101, column 't': 'later' is no number",
        "Correct",
    ),
    (
        text(changed(2, {40: "fault"})),
        f"line 42, column 'elbow.position': {FAULT}",
        "Correct",
    ),
    (
        text(["\n", *changed(2, {40: "fault"})]),
        f"line 44, column 'elbow.position': {FAULT}",
        "",
    ),
    (
        text([row + ",1.0" * (i in (10, 50, 90)) for i, row in enumerate(ROWS)]),
        "line 12 has 5 fields, the header 4; so do 3 of 200",
        "as many fields",
    ),
    (text(ROWS, "time,a,b,c"), "no column", "[channels]"),
    (
        text([row + ",0" for row in ROWS], ",".join(["time", *NAMES[1:], "stamp"])),
        "or stamp",
        "",
    ),
    (
        beside("0.0", "elbow.position"),
        "'elbow.position' is there 2 times",
        "a name of its own",
    ),
    (NUL, f"line {text(ROWS)[:3000].count(10) + 1} holds NUL bytes", "tr -d"),
    (text(ROWS).decode().encode("utf-16"), "UTF-16", "iconv"),
    (text(ROWS) + b"1," * (20 << 20), "a line is longer than 8 MB", "line feed"),
]
NO_TABLES = [
    (text([]), "no line of data", "Record again"),
    (text(["s,rad,rad,rad", *ROWS]), "line 2 holds no number", "A line of units"),
    (b"hello\nworld\n", "no table", "line of names"),
    (b"# only\n# comments\n", "no line of names", "line of names"),
    (b"t  q_0  q_1\n0  1  2\n", "varying number of spaces", "tr -s"),
    (b'{"a": 1, "b": 2}\n', "no line of data", "Record again"),
]


@pytest.mark.parametrize(("content", "message", "hint"), [*REFUSED, *NO_TABLES])
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, content: bytes, message: str, hint: str
) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, content)
    assert message in caught.value.message
    assert hint in caught.value.hint
    assert caught.value.where == str(tmp_path / "log.csv")
    if (content, message, hint) in NO_TABLES:
        with pytest.raises(InputError):
            check_log(tmp_path / "log.csv")


def test_line_without_end_at_once(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    with path.open("wb") as file:  # a sparse file: 10 GB that take no room
        file.write(b"t,q_0," * 200_000)
        file.truncate(10 << 30)
    with pytest.raises(InputError, match="longer than 1048576 bytes"):
        check_log(path)
