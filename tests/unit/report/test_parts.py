"""Parts of the page: what is kept of lines, words, numbers; payloads and plans."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seqid_cli.compare import compare
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.prediction import FileId
from seqid_cli.report.collection import collect
from seqid_cli.report.make import make_report
from seqid_cli.report.sections.torque_figures import extremes, pieces
from seqid_cli.report.words import (
    command,
    expression,
    interval,
    listed,
    number,
    percent,
    unit_text,
    with_error,
)
from tests.unit.params.documents import inertia_file
from tests.unit.report.pages import good_documents, payload_file, plan_file, source

finite = st.floats(-1e6, 1e6)


@settings(max_examples=60, deadline=None)
@given(st.lists(finite, min_size=1, max_size=400), st.integers(1, 40))
def test_every_column_keeps_its_extremes(values: list[float], columns: int) -> None:
    x, y = np.arange(len(values), dtype=float), np.array(values)
    kept = extremes(x, y, columns)
    assert np.all(np.diff(kept) > 0)
    assert kept[0] == 0
    assert kept[-1] == len(x) - 1
    assert len(kept) <= 2 * columns + 2
    span = max(x[-1], 1e-300)
    column = np.minimum((x / span * columns).astype(int), columns - 1)
    for place in range(columns):  # the slow, obvious way
        mine = np.flatnonzero(column == place)
        if len(mine):
            shown = y[np.intersect1d(mine, kept)]
            assert shown.max() == y[mine].max()
            assert shown.min() == y[mine].min()


def test_lines_break_at_gaps_and_missing_values() -> None:
    t = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 5.2, 5.3])
    good = np.array([True, True, True, True, True, False, True])
    assert pieces(t, good) == [slice(0, 3), slice(3, 5), slice(6, 7)]
    assert pieces(t[:0], good[:0]) == []
    assert pieces(np.array([1.0, 1.0]), np.array([True, True])) == [slice(0, 2)]


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (with_error(1.234567, 0.0123), ("1.235", "0.012")),
        (with_error(-4.21669, 0.00283), ("\u22124.2167", "0.0028")),
        (with_error(2.0, 0.0), ("2.0000", "0")),
        (interval(1.0, 0.1), "0.80 to 1.20"),
        (interval(1.0, 0.0), "\u2013"),
        (number(None), "\u2013"),
        (number(float("nan")), "\u2013"),
        (number(-1.5e-7), "\u22121.50e\u22127"),
        (number(1234567.0), "1.23e6"),
        (percent(0.0234), "2.3 %"),
        (unit_text("kg m^2"), "kg\u202fm\u00b2"),
        (unit_text("rad/s^2"), "rad/s\u00b2"),
        (unit_text("1"), ""),
        (listed(["a"]), "a"),
        (listed(["a", "b", "c"]), "a, b and c"),
        (listed(list("abcdefgh"), 2), "a, b and 6 more"),
        (command("seqid", "LOG...", "-p", "a b.json"), "seqid LOG... -p 'a b.json'"),
        (expression({"m_3": -0.425}, ""), "\u22120.425\u202f<i>m</i><sub>3</sub>"),
        (
            expression({"Izz_2": 1.0, "mx_3": 2.0}, ""),
            "<i>I</i><sub>zz\u202f2</sub> + 2\u202f<i>m</i>x<sub>3</sub>",
        ),
        (expression({}, "<b>"), "&lt;b&gt;"),
        (expression({"<b>_1": 1.0}, ""), "&lt;b&gt;_1"),
    ],
)
def test_numbers_names_and_formulas_as_they_are_shown(shown: object, expected: object) -> None:
    assert shown == expected


def test_without_them_there_is_no_such_section() -> None:
    sections = make_report(good_documents()).sections
    assert not {"payload", "plan"} & {section.id for section in sections}


def test_a_payload_of_an_older_model_is_refused() -> None:
    parameters, _ = good_documents()
    used = FileId(path=parameters.path, sha256="1" * 64)
    with pytest.raises(ConfigError, match="has changed since") as caught:
        collect([parameters, source("payload.json", payload_file(used))])
    assert "seqid payload" in (caught.value.hint or "")


def test_plans_are_not_compared(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        write_json_atomic(tmp_path / name, plan_file())
    with pytest.raises(UsageError, match="is a plan file"):
        compare(tmp_path / "a.json", tmp_path / "b.json")
    write_json_atomic(tmp_path / "c.json", inertia_file())
    with pytest.raises(UsageError, match="is a plan file"):
        compare(tmp_path / "c.json", tmp_path / "a.json")
