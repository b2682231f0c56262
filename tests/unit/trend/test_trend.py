"""What changed of robots over dates, beyond its error."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from seqid_cli import shares
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.schema import EffectOfJoint, InputLog, ParameterFile
from seqid_cli.report import report
from seqid_cli.trend import TrendOptions, trend
from tests.unit.params.documents import inertia_file

DATES = 12
ERROR = 0.01
STEP = np.where(np.arange(DATES) >= 7, 0.1, 0.0)


def dated(number: int) -> str:
    return f"{np.datetime64('2026-01-01') + 7 * number}T08:00:00Z"


def history(
    seed: int, change: np.ndarray | None = None, scatter: float = 1.0
) -> list[ParameterFile]:
    """Files of one robot whose gravity parameters scatter; the first one's values
    change.
    """
    rng = np.random.default_rng(seed)
    files = []
    for number in range(DATES):
        file = inertia_file()
        for stage in (file.stages.gravity, file.stages.inertia):
            for k, parameter in enumerate(stage.parameters):
                parameter.value = 1.25 + scatter * ERROR * float(rng.normal())
                parameter.std_error = ERROR
                if change is not None and stage is file.stages.gravity and k == 0:
                    parameter.value += float(change[number])
        files.append(replace(file, created=dated(number)))
    return files


@pytest.mark.parametrize(
    ("kind", "values", "error"),
    [
        ("step", STEP, ERROR * np.sqrt(1 / 7 + 1 / 5)),
        ("drift", np.linspace(0.0, 0.15, DATES), None),
    ],
)
def test_a_change_is_named_with_its_date(
    kind: str, values: np.ndarray, error: float
) -> None:
    (entry,) = trend(history(1, values)).changes
    assert (entry.stage, entry.kind) == ("gravity", kind)
    assert entry.change == pytest.approx(values[-1], abs=0.04)
    if error:
        assert entry.since == dated(7)
        assert entry.std_error == pytest.approx(error, rel=1e-6)
    assert trend(history(1, values), TrendOptions(rtol=0.2)).alarm is False


@pytest.mark.slow
def test_a_healthy_robot_gives_no_alarm() -> None:
    found = [trend(history(seed)) for seed in range(20)]
    assert [file.alarm for file in found] == [False] * 20


def test_files_count_by_their_dates_and_quantities_where_two_hold_them() -> None:
    files = history(1, STEP)
    found = trend(files)
    alone = replace(files[3].stages.gravity.parameters[0], name="mz_1")
    files[3].stages.gravity.parameters.append(alone)
    again = trend(files[::-1])
    assert (again.changes, again.series) == (found.changes, found.series)


def test_scatter_beyond_the_errors_is_seen(tmp_path: Path) -> None:
    for robot in range(4):
        folder = tmp_path / f"robot_{robot}"
        folder.mkdir()
        for number, file in enumerate(history(10 + robot, scatter=3.0)):
            write_json_atomic(folder / f"{number}.json", file)
    files, table = sorted(tmp_path.glob("*/*.json")), tmp_path / "all.parquet"
    found = trend(files, TrendOptions(by="folder"), table=table)
    assert found.alarm is False
    assert found.robots == [f"robot_{k}" for k in range(4)]
    assert found.inflation["gravity"] == pytest.approx(3.0, rel=0.35)
    assert pq.read_table(table).num_rows == sum(len(own.values) for own in found.series)


def test_friction_that_follows_the_temperature_is_no_change() -> None:
    files = []
    for number, celsius in enumerate(np.linspace(20.0, 40.0, DATES)):
        file = inertia_file()
        for joint in file.stages.friction.joints.values():
            cooler = (1.2 - 0.01 * celsius) * np.array(joint.positive)
            joint.covariance = (1e-8 * np.eye(cooler.size)).tolist()
            joint.positive = joint.negative = cooler.tolist()
            joint.temperature = float(celsius)
        files.append(replace(file, created=dated(number)))
    assert trend(files).alarm is False
    for file in files:
        for joint in file.stages.friction.joints.values():
            joint.temperature = None
    assert {entry.stage for entry in trend(files).changes} == {"friction"}


def test_an_effect_that_appears_is_told() -> None:
    files, backlash = history(5), EffectOfJoint(effect="backlash", joint="elbow")
    for number, file in enumerate(files):
        file.stages.effects = [backlash] if number >= 8 else []
    (entry,) = trend(files).changes
    assert (entry.name, entry.joint, entry.kind) == ("backlash", "elbow", "appeared")
    assert entry.since == dated(8)


def test_what_the_first_refinement_added_is_told() -> None:
    """Files before it were not searched: they say nothing of the effect."""
    files, backlash = history(5), EffectOfJoint(effect="backlash", joint="elbow")
    for number, file in enumerate(files):
        file.stages.effects = [backlash] if number >= 8 else None
    (entry,) = trend(files).changes
    assert (entry.name, entry.kind, entry.since) == ("backlash", "added", dated(8))


def test_the_date_of_a_file_is_that_of_its_newest_log() -> None:
    """Whenever it was identified; stamps that are no dates say nothing."""
    files = [replace(file, created=dated(0)) for file in history(1, STEP)]
    for number, file in enumerate(files):
        stamps = [dated(number).replace("08:", "07:"), dated(number)]
        file.inputs = [
            InputLog(path="a", sha256="a" * 64, samples=1, recorded=stamps),
            InputLog(path="b", sha256="b" * 64, samples=1, recorded=[0.0, 12.5]),
        ]
    assert trend(files[::-1]).changes == trend(history(1, STEP)).changes


def test_a_change_is_a_share_of_what_was_before() -> None:
    (entry,) = trend(history(1, STEP)).changes
    assert entry.relative == pytest.approx(entry.change / entry.before)
    assert shares.change(5.44, 8.30) == pytest.approx(0.5257, abs=1e-4)
    assert shares.change(-2.0, -3.0) == pytest.approx(0.5)
    assert shares.change(1e-9, 2.0, 1e-3) == pytest.approx(1.0)
    assert shares.change_in_percent(0.5257) == "+52.6 %"
    assert shares.change_in_percent(-0.05) == "-5.0 %"


def test_files_that_tell_no_change_are_refused() -> None:
    files = history(7)
    with pytest.raises(UsageError, match="no robot has two"):
        trend(files[:1])
    with pytest.raises(ConfigError, match="is no date"):
        trend([files[0], replace(files[1], created="yesterday")])


def test_the_page_shows_what_changed(tmp_path: Path) -> None:
    trend(history(1, STEP), output=tmp_path / "trend.json")
    made = report(tmp_path / "trend.json", tmp_path / "trend.html")
    assert (made.verdict, made.robot) == ("poor", "arm")
    assert [section.id for section in made.sections] == ["verdict", "robot-1"]
    text = (tmp_path / "trend.html").read_text()
    assert text.count("<figure") == 1
    for shown in (
        "gravity mx_1",
        dated(7)[:10],
        "Trend report",
        "1 change beyond the error: arm",
    ):
        assert shown in text
