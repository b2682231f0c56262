"""The date of a result: of its newest input, whatever the clock on the wall says."""

import os
from pathlib import Path

import pytest

from seqid_cli.errors import UsageError
from seqid_cli.logs.storage.files import time_of_log
from seqid_cli.logs.storage.remote import TableLog
from seqid_cli.params import dates
from seqid_cli.params.dates import created_from, recorded_between
from tests.unit.params.documents import friction_file

NEW_YEAR_S = 1_767_225_600.0  # 2026-01-01


def test_stamps_that_are_dates_are_told_as_dates() -> None:
    told = recorded_between(NEW_YEAR_S, NEW_YEAR_S + 12.25)
    assert told == ["2026-01-01T00:00:00.000000Z", "2026-01-01T00:00:12.250000Z"]
    assert recorded_between(0.0, 107.245) == [0.0, 107.245]
    assert recorded_between(86400.5, 86401.5) == [86400.5, 86401.5]


def test_the_newest_input_dates_a_result() -> None:
    file = friction_file()
    file.created = "2026-01-01T02:00:00+01:00"
    assert created_from([file]) == "2026-01-01T01:00:00Z"
    assert created_from([file], [NEW_YEAR_S]) == "2026-01-01T01:00:00Z"
    assert created_from([file], [NEW_YEAR_S + 7200.9]) == "2026-01-01T02:00:00Z"
    file.created = "yesterday"
    assert created_from([file], [NEW_YEAR_S]) == "2026-01-01T00:00:00Z"


def test_the_environment_dates_all_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(dates.VARIABLE, "0")
    assert created_from([friction_file()], [NEW_YEAR_S]) == "1970-01-01T00:00:00Z"
    for wrong in ("", "today", "-1", "1.5", "9" * 40):
        monkeypatch.setenv(dates.VARIABLE, wrong)
        with pytest.raises(UsageError, match="is no number of seconds"):
            created_from([], [NEW_YEAR_S])


def test_a_file_dates_a_log_whose_stamps_are_no_dates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "table_1.parquet"
    log.write_bytes(b"PAR1")
    os.utime(log, (NEW_YEAR_S, NEW_YEAR_S))
    assert time_of_log(log, (0.0, 5.0)) == NEW_YEAR_S
    assert time_of_log(log, None) == NEW_YEAR_S
    assert time_of_log(log, (NEW_YEAR_S + 1.0, NEW_YEAR_S + 2.0)) == NEW_YEAR_S + 2.0
    # A table in memory is no file, though one may have its name.
    assert time_of_log(TableLog("table_1.parquet"), (0.0, 5.0)) is None
    assert time_of_log(tmp_path / "missing.parquet", (0.0, 5.0)) is None


def test_the_robot_file_dates_what_has_no_other_date(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    robot.touch()
    os.utime(robot, (NEW_YEAR_S, NEW_YEAR_S))
    assert created_from([], otherwise=robot) == "2026-01-01T00:00:00Z"
    assert (
        created_from([], [NEW_YEAR_S + 60.0], otherwise=robot) == "2026-01-01T00:01:00Z"
    )
    assert created_from([], otherwise=tmp_path / "none") >= "2026-01-01T00:00:00Z"
