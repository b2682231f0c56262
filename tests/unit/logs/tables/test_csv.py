"""CSV logs: every way of writing them, and what is wrong with them."""

import datetime as dt
from collections.abc import Callable
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
DATA = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)
NAMES = ["t", *(f"{name}.position" for name in JOINTS)]
TABLE = np.column_stack([MOTION.t, MOTION.q])


VALUES = 100.0 + 100.0 * np.random.default_rng(3).uniform(-1.0, 1.0, len(TABLE))


def lines(table: Array = TABLE, delimiter: str = ",") -> list[str]:
    return [delimiter.join(repr(float(v)) for v in row) for row in table]


def write(path: Path, rows: list[str], header: str = ",".join(NAMES), end: str = "\n") -> Path:
    path.write_bytes((end.join([header, *rows]) + end).encode())
    return path


def read(path: Path) -> Recording:
    return read_recording(path, make_robot())


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("bom", ["", "\ufeff"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_delimiter_line_end_and_byte_order_mark(
    tmp_path: Path, delimiter: str, bom: str, end: str
) -> None:
    path = write(tmp_path / "log.csv", lines(delimiter=delimiter), bom + delimiter.join(NAMES), end)
    recording = read(path)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert (recording.format, recording.partial) == ("csv", "")


@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_decimal_commas(tmp_path: Path, delimiter: str) -> None:
    rows = [line.replace(".", ",") for line in lines(delimiter=delimiter)]
    path = write(tmp_path / "log.csv", rows, delimiter.join(NAMES))
    np.testing.assert_array_equal(read(path).q, MOTION.q)


@pytest.mark.parametrize(
    "header",
    [
        "# made by a logger\n#\n" + ",".join(NAMES),
        "# " + ",".join(NAMES),
        "% one\n\n% " + ",".join(NAMES),
        ",".join(f'"{name}"' for name in NAMES),
        ", ".join(NAMES),
    ],
)
def test_comments_quotes_and_spaces_around_names(tmp_path: Path, header: str) -> None:
    np.testing.assert_array_equal(read(write(tmp_path / "log.csv", lines(), header)).q, MOTION.q)


def test_every_line_ends_with_a_delimiter(tmp_path: Path) -> None:
    rows = [line + "," for line in lines()]
    np.testing.assert_array_equal(read(write(tmp_path / "log.csv", rows)).q, MOTION.q)
    path = write(tmp_path / "both.csv", rows, ",".join(NAMES) + ",")
    np.testing.assert_array_equal(read(path).q, MOTION.q)


def test_missing_values(tmp_path: Path) -> None:
    rows = [line.split(",") for line in lines()]
    for i, word in enumerate(["", "nan", "NaN", "-nan", "null", "None", "inf", "1e400", "NA"]):
        rows[20 + 15 * i][2] = word
    path = write(tmp_path / "log.csv", [",".join(row) for row in rows])
    recording = read(path)
    assert recording.valid.all()
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-6)
    assert recording.partial == ""


def test_columns_without_any_value_and_other_columns(tmp_path: Path) -> None:
    header = ",".join([*NAMES, "shoulder.velocity", "note", "gripper.position"])
    rows = [f"{line},,moving,0.1" for line in lines()]
    recording = read(write(tmp_path / "log.csv", rows, header))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.dq is None
    assert any("gripper" in warning for warning in recording.health.warnings)


def stamps(form: str) -> list[str]:
    start = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
    whole = [start + dt.timedelta(seconds=float(t)) for t in MOTION.t]
    if form == "iso":
        return [each.strftime("%Y-%m-%d %H:%M:%S.%f") for each in whole]
    per = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[form]
    return [str(round(t * per)) if form != "s" else repr(float(t)) for t in MOTION.t]


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("time", "s"),
        ("Timestamp", "iso"),
        ("time_ms", "ms"),
        ("t_us", "us"),
        ("timestamp [ns]", "ns"),
        ("__time", "s"),
        ("Zeit [s]", "s"),
    ],
)
def test_names_and_units_of_time(tmp_path: Path, name: str, form: str) -> None:
    rows = [f"{t},{line.split(',', 1)[1]}" for t, line in zip(stamps(form), lines(), strict=True)]
    path = write(tmp_path / "log.csv", rows, ",".join([name, *NAMES[1:]]))
    recording = read(path)
    np.testing.assert_allclose(recording.t, MOTION.t, atol=2e-6)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-5)


def test_stamp_in_two_columns(tmp_path: Path) -> None:
    whole = np.rint(MOTION.t * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    rows = [
        f"{stamp // 10**9},{stamp % 10**9},{line.split(',', 1)[1]}"
        for stamp, line in zip(whole.tolist(), lines(), strict=True)
    ]
    header = ",".join(["header.stamp.sec", "header.stamp.nanosec", *NAMES[1:]])
    recording = read(write(tmp_path / "log.csv", rows, header))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.start == pytest.approx(1_700_000_000.0, abs=1e-6)


def test_names_of_the_robot_file_win(tmp_path: Path) -> None:
    header = ",".join(["clock", "a_1", "a_2", "a_3", "shoulder.position"])
    path = write(tmp_path / "log.csv", [line + ",9.0" for line in lines()], header)
    robot = make_robot(channels=Channels(time="clock", position="a_{index}"))
    np.testing.assert_array_equal(read_recording(path, robot).q, MOTION.q)
    missing = make_robot(channels=Channels(time="clock", position="b_{index}"))
    with pytest.raises(InputError, match="b_1"):
        read_recording(path, missing)


def test_what_the_robot_file_leaves_out_is_found_by_name(tmp_path: Path) -> None:
    table = np.column_stack([TABLE, MOTION.tau])
    robot = make_robot(channels=Channels(position="enc_{index0}"))
    for torque in ("{}.torque", "effort.{}", "{}/tau"):
        header = ["t", "enc_0", "enc_1", "enc_2", *(torque.format(name) for name in JOINTS)]
        path = write(tmp_path / "log.csv", lines(table), ",".join(header))
        recording = read_recording(path, robot)
        np.testing.assert_array_equal(recording.q, MOTION.q)
        assert recording.tau is not None
        np.testing.assert_array_equal(recording.tau, MOTION.tau)


def test_rtde_with_its_own_accelerometer(tmp_path: Path) -> None:
    tool = Imu("tool", 2, np.zeros((3, 3)), np.eye(3))
    robot = make_robot(imus=(tool,), constants=0.1, gear_ratio=100.0)
    recording = read_recording(csv_rtde(tmp_path / "log", DATA), robot)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, 10.0 * MOTION.tau, rtol=1e-12)
    assert recording.temperature is not None
    assert (recording.temperature == 31.5).all()
    assert recording.start == 1234.5
    np.testing.assert_array_equal(recording.accelerometers["tool"][7], [0.1, -0.2, 9.8])


def test_libfranka_names_with_time_in_seconds_are_noticed(tmp_path: Path) -> None:
    header = ",".join(["time", *(f"state.q[{i}]" for i in range(3))])
    recording = read(write(tmp_path / "log.csv", lines(), header))
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-12)
    assert any("read as s" in warning for warning in recording.health.warnings)


def test_last_line_cut_off_is_left_out_and_told(tmp_path: Path) -> None:
    rows = lines()
    rows[-1] = rows[-1].split(",")[0] + ",0.1"
    recording = read(write(tmp_path / "log.csv", rows))
    assert len(recording.t) == 199
    assert recording.partial == "line 201 has 2 fields, the header 4; 1 of 200 lines were left out"


@pytest.mark.parametrize("form", ["{!r}", "{:.6f}", "{:.9e}", "{:.0f}"])
@pytest.mark.parametrize("tail", ["", "\0\0"])
def test_a_last_line_without_an_end_is_read_where_it_is_whole(
    tmp_path: Path, form: str, tail: str
) -> None:
    rows = [f"{line},{form.format(float(v))}" for line, v in zip(lines(), VALUES, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join([*NAMES, "more"]), *rows]))
    recording = read(path)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert (recording.partial, recording.health.warnings) == ("", ())


@pytest.mark.parametrize(
    ("form", "lost"), [("{!r}", 5), ("{:.6f}", 1), ("{:.9e}", 1), ("{:.9e}", 3), ("{:07.0f}", 2)]
)
def test_a_last_number_cut_off_is_left_out_and_told(tmp_path: Path, form: str, lost: int) -> None:
    rows = [f"{line},{form.format(float(v))}" for line, v in zip(lines(), VALUES, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join([*NAMES, "more"]), *rows])[:-lost])
    recording = read(path)
    np.testing.assert_array_equal(recording.q, MOTION.q[:-1])
    assert recording.partial == ""
    assert any("cut short" in warning for warning in recording.health.warnings)


def test_a_whole_last_text_without_an_end_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join([*NAMES, "state"]), *(f"{x},moving" for x in lines())]))
    np.testing.assert_array_equal(read(path).q, MOTION.q)


Rows = list[str]


def ragged(rows: Rows) -> Rows:
    return [row + ",1.0" * (i in (10, 50, 90)) for i, row in enumerate(rows)]


def late(rows: Rows) -> Rows:
    return [*rows[:99], "later" + rows[99][rows[99].index(",") :], *rows[100:]]


@pytest.mark.parametrize(
    ("header", "change", "message", "hint"),
    [
        (NAMES, lambda rows: [r.replace(".", ",") for r in rows], "decimal commas", "semicolons"),
        (NAMES, late, "line 101, column 't': 'later' is no number", ""),
        (NAMES, ragged, "line 12 has 5 fields, the header 4; so do 3 of 200", ""),
        (["time", "a", "b", "c"], list, "no column", "[channels]"),
        (["time", *NAMES[1:], "stamp"], lambda rows: [r + ",0" for r in rows], "time or stamp", ""),
        (
            [*NAMES[:3], "elbow.position", "wrist.position"],
            lambda rows: [r + ",0.0" for r in rows],
            "'elbow.position' is there 2 times",
            "",
        ),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, header: list[str], change: Callable[[Rows], Rows], message: str, hint: str
) -> None:
    path = write(tmp_path / "log.csv", change(lines()), ",".join(header))
    with pytest.raises(InputError) as caught:
        read(path)
    assert message in caught.value.message
    assert hint in caught.value.hint


@pytest.mark.parametrize("blank", [0, 2])
def test_text_in_a_number_names_line_and_column(tmp_path: Path, blank: int) -> None:
    rows = lines()
    rows[40] = rows[40].replace(rows[40].split(",")[2], "fault")
    rows[30] += "\n" * blank
    with pytest.raises(InputError) as caught:
        read(write(tmp_path / "log.csv", rows))
    assert (
        caught.value.message == f"line {42 + blank}, column 'elbow.position': 'fault' is no number"
    )
    assert caught.value.hint


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (",".join(NAMES) + "\n", "no line of data"),
        (",".join(NAMES) + "\ns,rad,rad,rad\n" + "\n".join(lines()), "line 2 holds no number"),
        ("hello\nworld\n", "no table"),
        ("# only\n# comments\n", "no line of names"),
        ("t  q_0  q_1\n0  1  2\n", "varying number of spaces"),
        ('{"a": 1, "b": 2}\n', "no line of data|no table"),
    ],
)
def test_files_that_are_no_tables(tmp_path: Path, content: str, fragment: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=fragment) as caught:
        check_log(path)
    assert caught.value.hint
    assert caught.value.where == str(path)


def test_columns_without_names_are_read_by_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*lines(), ""]))
    with pytest.raises(InputError, match="has no line of names: its columns are numbered 1 to 4"):
        read(path)
    robot = make_robot(channels=Channels(time=1, position=(2, 3, 4)))
    np.testing.assert_array_equal(read_recording(path, robot).q, MOTION.q)
    robot = make_robot(channels=Channels(time=1, position=(4, 3, 2)))
    np.testing.assert_array_equal(read_recording(path, robot).q, MOTION.q[:, ::-1])


def test_nul_bytes(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", lines())
    data = path.read_bytes()
    path.write_bytes(data[:3000] + b"\0" * 50 + data[3000:])
    with pytest.raises(InputError, match="NUL bytes") as caught:
        read(path)
    assert f"line {data[:3000].count(10) + 1} " in caught.value.message


def test_utf16_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join(NAMES), *lines()]), encoding="utf-16")
    with pytest.raises(InputError, match="UTF-16") as caught:
        read(path)
    assert "iconv" in caught.value.hint


def test_names_in_latin_1(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    header = ",".join([*NAMES, "temp [\xb0C]"])
    path.write_bytes("\n".join([header, *(line + ",20" for line in lines()), ""]).encode("latin-1"))
    np.testing.assert_array_equal(read(path).q, MOTION.q)


def test_line_without_end_at_once(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    with path.open("wb") as file:  # a sparse file: 10 GB that take no room
        file.write(b"t,q_0," * 200_000)
        file.truncate(10 << 30)
    with pytest.raises(InputError, match="longer than 1048576 bytes"):
        check_log(path)


def test_line_without_end_later(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", lines())
    with path.open("ab") as file:
        file.write(b"1," * (20 << 20))
    with pytest.raises(InputError, match="a line is longer than 8 MB") as caught:
        read(path)
    assert caught.value.hint


def test_too_large_numbers_are_missing(tmp_path: Path) -> None:
    rows = lines()
    rows[50] = rows[50].replace(rows[50].split(",")[1], "9" * 400)
    recording = read(write(tmp_path / "log.csv", rows))
    assert any("infinite" in warning for warning in recording.health.warnings)
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-6)


def test_ragged_line_of_any_bytes_is_left_out(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "log.csv", lines())
    parts = path.read_bytes().split(b"\n")
    parts[20] = b"\xff\xfe\xbe"
    path.write_bytes(b"\n".join(parts))
    recording = read(path)
    assert recording.partial.startswith("line 21 has 1 fields, the header 4; 1 of 200 lines")
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-6)
    assert capfd.readouterr() == ("", "")
