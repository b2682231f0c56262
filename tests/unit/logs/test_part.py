"""Parts of logs: moments as people write them, and the same part by every way in."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError, UsageError
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.long import open_long
from seqid_cli.logs.pieces import read_parts
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.reading import ALL, LogPart, Moment, Reading, part_of_words
from seqid_cli.logs.recording import Recording
from tests.unit.logs.samples import (
    ARRAY,
    GYRO,
    grid,
    make_motion,
    make_robot,
    write_motion,
)

T0_S = 1_700_000_000.0  # first stamp of a log of messages
ROBOT = make_robot(imus=(ARRAY, GYRO))
MOTION = make_motion(grid(1000))  # 10 s
PART = LogPart.of(2, 8, ["3,4.5"])
USED = (MOTION.t >= 2.0) & (MOTION.t <= 8.0) & ~((MOTION.t >= 3.0) & (MOTION.t <= 4.5))


def read(path: Path, part: LogPart) -> Recording:
    return read_recording(path, ROBOT, reading=Reading(part=part))


@pytest.mark.parametrize("suffix", [".mcap", ".parquet"])
def test_a_part_is_what_the_log_has_there(tmp_path: Path, suffix: str) -> None:
    path = write_motion(tmp_path / f"log{suffix}", MOTION)
    whole = read_recording(path, ROBOT)
    part = read(path, PART)
    assert part.start == pytest.approx(whole.start + 2.0)
    assert part.length == pytest.approx(6.0)

    t = part.t + 2.0
    expected = np.isin(np.round(t, 6), np.round(MOTION.t[USED], 6))
    np.testing.assert_array_equal(part.valid, expected)
    rows = np.flatnonzero(USED)
    np.testing.assert_allclose(part.q[part.valid], whole.q[rows], atol=1e-9)
    np.testing.assert_allclose(part.tau[part.valid], whole.tau[rows], atol=1e-9)
    for name, values in whole.accelerometers.items():
        np.testing.assert_allclose(
            part.accelerometers[name][part.valid], values[rows], atol=1e-9
        )


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["@{}", "{}", "2023-11-14T22:13:{:02.0f}Z"])
def test_stamps_and_seconds_say_the_same(tmp_path: Path, clock: str) -> None:
    path = write_motion(tmp_path / "log.mcap", MOTION)
    first = 20.0 if "Z" in clock else T0_S
    part = LogPart.of(
        clock.format(first + 2),
        clock.format(first + 8),
        [f"{clock.format(first + 3)},{clock.format(first + 5)}"],
    )
    by_stamp = read(path, part)
    by_seconds = read(path, LogPart.of(2, 8, [(3, 5)]))
    assert by_stamp.start == by_seconds.start == T0_S + 2.0
    np.testing.assert_array_equal(by_stamp.valid, by_seconds.valid)
    np.testing.assert_array_equal(by_stamp.q, by_seconds.q)


@pytest.mark.parametrize("suffix", [".mcap", ".parquet"])
def test_every_way_in_gives_the_same_part(tmp_path: Path, suffix: str) -> None:
    """Held, passed over, and in parts of windows."""
    path = write_motion(tmp_path / f"log{suffix}", MOTION)
    robot = replace(ROBOT, imus=())
    reading = Reading(part=PART)
    held = read_recording(path, robot, reading=reading)

    long = open_long(path, robot, reading=reading)
    assert long is not None
    assert (long.samples, long.start) == (len(held.t), pytest.approx(held.start))
    blocks = list(long.blocks())
    valid = np.concatenate([block.valid.copy() for block in blocks])
    np.testing.assert_array_equal(valid, held.valid)

    log = LogFile.at(path, reading=reading)
    parts = [recording for recording, _ in read_parts(log, robot, most_values=600)]
    stamps = np.concatenate([part.start + part.t[part.valid] for part in parts])
    inside = np.unique(np.round(stamps - held.start, 6))
    assert set(inside) == set(np.round(held.t[held.valid], 6))


def test_what_is_left_out_on_purpose_is_no_gap(tmp_path: Path) -> None:
    path = write_motion(tmp_path / "log.parquet", MOTION)
    whole = {finding.code for finding in inspect_log(path, ROBOT).findings}
    seen = inspect_log(path, ROBOT, reading=Reading(part=PART))
    assert {finding.code for finding in seen.findings} <= whole
    assert seen.stamps_s == pytest.approx((2.0, 8.0), abs=0.02)


def test_nothing_left_is_said_with_the_log_s_own_time(tmp_path: Path) -> None:
    path = write_motion(tmp_path / "log.mcap", MOTION)
    with pytest.raises(InputError, match=r"by --from 11\.0: it runs from @17000") as no:
        read(path, LogPart.of(11))
    assert "9.990 s" in no.value.message


def test_an_earlier_part_counts_where_none_is_asked_for(tmp_path: Path) -> None:
    path = write_motion(tmp_path / "log.parquet", MOTION)
    used = {LogFile.at(path).sha256: LogPart.of(stop=4)}
    recording = read_recording(path, ROBOT, reading=Reading(part_by_sha256=used))
    assert recording.length == pytest.approx(4.0)
    asked = Reading(part=LogPart.of(0), part_by_sha256=used)
    assert read_recording(path, ROBOT, reading=asked).length == pytest.approx(9.99)


def test_words_say_the_same_part() -> None:
    part = LogPart.of("1.5", "2026-03-01T12:00:00Z", ["3,5", "@7.25..@8", (1, 2)])
    assert part_of_words(part.words) == part
    assert part_of_words([]) == ALL
    assert not ALL
    assert part


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("12.5", Moment(12.5)),
        ("@12.5", Moment(12.5, is_stamp=True)),
        ("1772366400", Moment(1772366400.0, is_stamp=True)),
        ("2026-03-01T12:00:00Z", Moment(1772366400.0, is_stamp=True)),
        ("2026-03-01 13:00:00+01:00", Moment(1772366400.0, is_stamp=True)),
        ("2026-03-01T12:00:00", Moment(1772366400.0, is_stamp=True)),
    ],
)
def test_moments(text: str, moment: Moment) -> None:
    assert Moment.of(text, "--from") == moment


@pytest.mark.parametrize("text", ["3,5", "3..5", "3:5", "3-5", " 3 , 5 "])
def test_ranges(text: str) -> None:
    assert LogPart.of(exclude=[text]).excluded == ((Moment(3.0), Moment(5.0)),)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"start": "soon"}, "--from 'soon' is no moment"),
        ({"stop": "nan"}, "--to 'nan' is no moment"),
        ({"start": "-3"}, "--from '-3' is no moment"),
        ({"start": 5, "stop": 5}, "--from and --to: 5.0 s is not before 5.0 s"),
        ({"exclude": ["3"]}, "--exclude '3' is no range of time"),
        ({"exclude": ["5,3"]}, "--exclude: 5.0 s is not before 3.0 s"),
        ({"exclude": ["x" * 1000]}, "is no range of time"),
    ],
)
def test_other_moments_are_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError) as refused:
        LogPart.of(**given)  # type: ignore[arg-type]
    assert message in refused.value.message
    assert len(refused.value.message) < 200
    assert refused.value.hint
