"""One file per quantity: found by name or declared, joined row by row, or refused."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.storage.files import expand
from seqid_cli.logs.tables.siblings import named, siblings
from seqid_cli.robot.types import Channels
from tests import Array
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot

MOTION = make_motion(grid(200))
VALUES = {"positions": MOTION.q, "velocities": MOTION.dq, "torques": MOTION.tau}


def write(path: Path, names: list[str], values: Array, t: Array | None) -> Path:
    columns = values if t is None else np.column_stack([t, values])
    header = ",".join(names if t is None else ["time", *names]) if names else ""
    np.savetxt(path, columns, delimiter=",", comments="", header=header, fmt="%.17g")
    if not names:  # numpy writes an empty line for it
        path.write_text(path.read_text().lstrip("\n"))
    return path


def split(
    folder: Path, names: list[str], *, t: Array | None = MOTION.t, stem: str = "{}"
) -> Path:
    """Write a file of each quantity; returns that of the positions."""
    for quantity, values in VALUES.items():
        write(folder / f"{stem.format(quantity)}.csv", names, values, t)
    return folder / f"{stem.format('positions')}.csv"


def check(path: Path, channels: Channels | None = None) -> None:
    recording = read_recording(path, make_robot(channels=channels))
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.dq, MOTION.dq)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)
    np.testing.assert_allclose(recording.t, MOTION.t, atol=1e-9)


@pytest.mark.parametrize(
    "names",
    [list(JOINTS), ["joint_0", "joint_1", "joint_2"], ["q1", "q2", "q3"]],
    ids=["names", "numbers", "names of positions everywhere"],
)
@pytest.mark.parametrize("stem", ["{}", "run_1_{}", "{} of monday"])
def test_files_that_belong_together_by_name(
    tmp_path: Path, names: list[str], stem: str
) -> None:
    lead = split(tmp_path, names, stem=stem)
    assert expand([str(tmp_path)]) == [lead]
    assert expand([str(path) for path in tmp_path.iterdir()]) == [lead]
    check(lead)
    assert inspect_log(lead, make_robot()).log.verdict != "unreadable"


def test_two_recordings_in_one_folder(tmp_path: Path) -> None:
    leads = [split(tmp_path, list(JOINTS), stem=f"{k}_{{}}") for k in ("a", "b")]
    assert expand([str(tmp_path)]) == leads
    for lead in leads:
        check(lead)


@pytest.mark.parametrize("names", [[], list(JOINTS)], ids=["without names", "names"])
def test_no_column_of_time_and_a_rate(tmp_path: Path, names: list[str]) -> None:
    lead = split(tmp_path, names, t=None)
    assert expand([str(tmp_path)]) == [lead]
    with pytest.raises(InputError, match="no column of the time") as lacking:
        read_recording(lead, make_robot())
    assert "[channels] rate = 200 (Hz)" in lacking.value.hint
    check(lead, Channels(rate=100.0))


def test_a_rate_holds_over_blocks_of_rows(tmp_path: Path) -> None:
    """A Parquet log that is passed over counts its rows on."""
    path = tmp_path / "log.parquet"
    names = [f"{joint}.position" for joint in JOINTS]
    table = pa.table(dict(zip(names, MOTION.q.T, strict=True)))
    pq.write_table(table, path, row_group_size=64)
    robot = make_robot(channels=Channels(rate=100.0))
    stamps = [raw.joints.stamp_ns for raw in LogFile.at(path).blocks(robot)]
    assert len(stamps) > 1
    np.testing.assert_allclose(np.concatenate(stamps) * 1e-9, MOTION.t, atol=1e-9)


def test_declared_files(tmp_path: Path) -> None:
    lead = write(tmp_path / "enc.csv", list(JOINTS), MOTION.q, MOTION.t)
    write(tmp_path / "vel_est.csv", list(JOINTS), MOTION.dq, MOTION.t)
    write(tmp_path / "ft.csv", list(JOINTS), MOTION.tau, MOTION.t)
    channels = Channels(files={"velocity": "vel_est.csv", "torque": "ft.csv"})
    check(lead, channels)
    missing = Channels(files={"torque": "nowhere.csv"})
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        read_recording(lead, make_robot(channels=missing))


def test_parquet_files(tmp_path: Path) -> None:
    for quantity, values in VALUES.items():
        table = pa.table({"t": MOTION.t} | dict(zip(JOINTS, values.T, strict=True)))
        pq.write_table(table, tmp_path / f"{quantity}.parquet")
    (lead,) = expand([str(tmp_path)])
    check(lead)


def test_rows_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    lead = split(tmp_path, list(JOINTS))
    torques = tmp_path / "torques.csv"
    write(torques, list(JOINTS), MOTION.tau[:-5], MOTION.t[:-5])
    with pytest.raises(InputError, match=r"torques.csv has 195 rows, positions.cs"):
        read_recording(lead, make_robot())
    write(torques, list(JOINTS), MOTION.tau, MOTION.t + 0.02)
    with pytest.raises(InputError, match=r"row 1 of torques.csv is of another time"):
        read_recording(lead, make_robot())


def test_the_digest_is_of_all_files(tmp_path: Path) -> None:
    lead = split(tmp_path, list(JOINTS))
    before = LogFile.at(lead).sha256
    write(tmp_path / "torques.csv", list(JOINTS), -MOTION.tau, MOTION.t)
    assert LogFile.at(lead).sha256 != before


def test_whole_logs_with_such_names_stay_logs(tmp_path: Path) -> None:
    """A log of the positions that holds torques itself needs no other file."""
    names = [f"{joint}.{q}" for q in ("position", "torque") for joint in JOINTS]
    both = np.hstack([MOTION.q, MOTION.tau])
    paths = [
        write(tmp_path / f"{quantity}.csv", names, both, MOTION.t)
        for quantity in ("position", "torque")
    ]
    assert expand([str(tmp_path)]) == paths
    assert siblings(paths[0]) == {}
    recording = read_recording(paths[0], make_robot())
    np.testing.assert_array_equal(recording.tau, MOTION.tau)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("positions.csv", ("position", "*.csv")),
        ("run1_q.csv", ("position", "run1_*.csv")),
        ("run1_tau.CSV", ("torque", "run1_*.csv")),
        ("desired_positions.csv", None),
        ("position_torque.csv", None),
        ("log.csv", None),
        ("positions.mcap", None),
    ],
)
def test_what_a_name_tells(name: str, told: tuple[str, str] | None) -> None:
    assert named(Path(name)) == told
