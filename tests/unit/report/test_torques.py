"""Torques in the report: read, refused where they do not fit, found, and drawn."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from seqid_cli.errors import InputError, UsageError
from seqid_cli.params.encode import encode
from seqid_cli.params.io import Document, Source
from seqid_cli.report.collection import Place, collect
from seqid_cli.report.make import make_report
from seqid_cli.report.plots import plot_torques
from seqid_cli.report.torque_figures.over_time import over_time
from seqid_cli.report.torque_figures.residual import over_quantity, spectrum
from seqid_cli.report.torques import TorqueTable
from tests import Array
from tests.unit.params.documents import JOINTS, inertia_file
from tests.unit.report.pages import (
    LINE_HZ,
    LOGS,
    SAMPLES,
    SPIKE,
    all_documents,
    good_documents,
    made_with,
    prediction_file,
    source,
    write_torques,
)

PLACE = Place("elbow", "N m", "rad")


def opened(path: Path) -> TorqueTable:
    return TorqueTable.open(path, collect(good_documents()))


def test_motion_that_is_not_known_is_not_drawn(tmp_path: Path) -> None:
    """Read a file that holds none, and an older one, which also lacks what was used."""
    path = write_torques(tmp_path / "t.parquet", motion=False)
    first, _ = opened(path).series("shoulder")
    assert np.isnan(first.position).all()
    assert over_quantity([first], PLACE, "position", "rad") is None
    table = pq.read_table(path)
    without_motion = [
        name
        for name in table.column_names
        if not name.endswith(("position", "velocity")) and name != "used"
    ]
    pq.write_table(table.select(without_motion), path)
    first, _ = opened(path).series("shoulder")
    assert first.position is None
    assert first.used.all()
    assert (
        "Spectrum of the residual" in make_report(good_documents(), torques=[path]).html
    )


Write = Callable[[Path], object]
JOINT_COLUMNS = {
    f"{j}.{k}": [0.0] * 3 for j in JOINTS for k in ("torque", "predicted", "residual")
}


def changed(name: str, change: Callable[[Array], Array]) -> Write:
    """Write torques with one column changed."""

    def write(path: Path) -> None:
        table = pq.read_table(write_torques(path))
        place = table.column_names.index(name)
        values = change(table[name].to_numpy())
        pq.write_table(table.set_column(place, name, pa.array(values)), path)

    return write


def columns(**by_name: object) -> Write:
    """Write a table of other columns beside those of the joints."""
    return lambda path: pq.write_table(pa.table({**by_name, **JOINT_COLUMNS}), path)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (
            partial(write_torques, joints=["a", "b"]),
            r"is about joints a, b.*inertia\.json",
        ),
        (
            partial(write_torques, logs=(LOGS[0], "c")),
            r"prediction\.json: c with 4000 samples",
        ),
        (
            partial(write_torques, logs=LOGS[:1]),
            r"validation/b\.parquet .* is in that only",
        ),
        (
            lambda path: pq.write_table(
                pq.read_table(write_torques(path)).slice(10), path
            ),
            rf"{LOGS[0]} with 3990 samples is in this file only",
        ),
        (changed("t", lambda x: x[::-1]), "goes back"),
        (changed("t", lambda x: np.where(x == 0.0, np.nan, x)), "missing"),
        (
            changed("elbow.torque", lambda x: np.where(x > 1.0, np.inf, x)),
            r"elbow\.torque is inf",
        ),
        *(
            (partial(Path.write_bytes, data=content), "is no torque file: ")
            for content in (b"", b"PAR1", b"PAR1" + b"\0" * 64 + b"PAR1", b"{}")
        ),
        (columns(x=[1.0] * 3), "is no torque file: .*log"),
        (columns(t=["a"] * 3, log=["a"] * 3), "its column t must hold numbers"),
        *(
            (columns(t=[0.0] * 3, log=log), "is no torque file: ")
            for log in (
                [{"a": 1}] * 3,
                [None] * 3,
                ["a", None, "a"],
                ["a", "b", "a"],
                [1.0] * 3,
            )
        ),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, write: Write, message: str
) -> None:
    path = tmp_path / "t.parquet"
    write(path)
    with pytest.raises(InputError, match=message) as caught:
        opened(path).series("elbow")
    assert caught.value.where == str(path)
    assert caught.value.hint


def test_lines_break_at_missing_values_and_where_time_jumps(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    number = np.arange(2 * SAMPLES)
    is_lost = (number >= 1000) & (number < 1200)
    jump_s = np.where(number % SAMPLES >= 2000, 5.0, 0.0)
    for change in (
        changed("elbow.residual", lambda x: np.where(is_lost, np.nan, x)),
        changed("t", lambda x: x + jump_s),
    ):
        change(path)
        first = opened(path).series("elbow")[0]
        drawn = str(over_time({"": first}, PLACE, [], 200).drawing)
        assert drawn.count('data-name="residual"') == 2
        assert "nan" not in drawn


def test_the_table_beside_the_prediction_is_found_if_it_fits(tmp_path: Path) -> None:
    parameters, prediction = good_documents()
    documents = [
        parameters,
        source(str(tmp_path / "prediction.json"), prediction.content),
    ]
    assert make_report(documents).torques == []
    write_torques(tmp_path / "torques.parquet")
    assert make_report(documents).torques == [str(tmp_path / "torques.parquet")]
    write_torques(tmp_path / "torques.parquet", logs=LOGS[:1])
    assert make_report(documents).torques == []
    shutil.copy(__file__, tmp_path / "torques.parquet")
    assert make_report(documents).torques == []


def of_two_models(
    folder: Path, *, names_model: bool = True
) -> tuple[list[Source[Document]], list[Path]]:
    """Predictions before and after refinement, and their torques, the worse first."""
    parameters, _, _, refined = all_documents()
    documents = [parameters, refined]
    torques = []
    for name, model, drop in (("before", parameters, 0.5), ("after", refined, 0.0)):
        prediction = made_with(prediction_file(), model)
        documents.append(source(str(folder / f"{name}.json"), prediction))
        hashes = [model.sha256] if names_model else []
        path = folder / f"{name}.parquet"
        torques.append(write_torques(path, parameters=hashes, drop=drop))
    return documents, torques


def test_torques_of_two_models_share_a_plot(tmp_path: Path) -> None:
    documents, torques = of_two_models(tmp_path)
    report = make_report(documents, torques=torques)
    # the refined one's first
    assert report.torques == list(map(str, reversed(torques)))
    drawn = report.html.split("<title>Torque of elbow, validation/a.parquet")[1].split(
        "</svg>"
    )[0]
    for name in ("measured", "after: refined.json", "before: inertia.json"):
        assert f'data-name="{name}"' in drawn
    table = report.html.split('id="torque-models"')[1].split("</table>")[0]
    assert "before: inertia.json" in table
    assert table.count("(2.0 %)") == table.count("(5.0 %)") == 2


def test_torques_belong_to_the_model_that_they_name(tmp_path: Path) -> None:
    documents, (torques_before, _) = of_two_models(tmp_path)
    without = [item for item in documents if not item.path.endswith("before.json")]
    with pytest.raises(InputError, match=r"is of another model than .*after\.json"):
        make_report(without, torques=[torques_before])
    torques_before.rename(tmp_path / "torques.parquet")
    assert make_report(documents).torques == [str(tmp_path / "torques.parquet")]
    documents, torques = of_two_models(tmp_path, names_model=False)
    with pytest.raises(UsageError, match=r"before\.parquet, .*after\.parquet"):
        make_report(documents, torques=torques)


def test_a_notebook_draws_the_torques_of_both(tmp_path: Path) -> None:
    documents, torques = of_two_models(tmp_path)
    files = [tmp_path / Path(item.path).name for item in documents]
    for path, item in zip(files, documents, strict=True):
        path.write_text(encode(item.content), encoding="utf-8")
    drawn = plot_torques(files, torques, "elbow")
    assert repr(drawn) == "<2 figures>"
    assert all('data-name="before: inertia.json"' in svg for svg in drawn.svg)
    with pytest.raises(UsageError, match="no torques of 'wrist'"):
        plot_torques(files, torques, "wrist")


def test_the_one_bad_sample_is_drawn(tmp_path: Path) -> None:
    series = opened(write_torques(tmp_path / "t.parquet")).series("elbow")[0]
    figure = over_time({"": series}, PLACE, [(1.0, 2.0)], 60)
    text = str(figure.drawing)
    line = text.split('data-name="residual"')[0].rpartition("<polyline")[2]
    points = line.split('points="')[1].split('"')[0].split()
    heights = [float(point.split(",")[1]) for point in points]
    assert len(heights) <= 122
    low, high, start, end = map(float, text.split('data-y="')[2].split("|")[:4])
    highest = low + (min(heights) - start) / (end - start) * (high - low)
    assert highest == pytest.approx(SPIKE, rel=0.02)
    assert "pushed from 1.00 to 2.00 s" in text
    assert len(figure.table.rows) == 20


def test_figures_hold_the_line_and_the_extremes_of_the_residual(tmp_path: Path) -> None:
    series = opened(write_torques(tmp_path / "t.parquet")).series("elbow")
    drawn = spectrum(series, PLACE, 30.0, 300)
    frequency, _ = max(drawn.table.values.rows, key=lambda row: row[1])
    assert frequency == pytest.approx(LINE_HZ, abs=0.2)
    assert f"Strongest at {frequency:.2f} Hz" in drawn.note
    most = max(item.residual[item.used].max() for item in series)
    for quantity in ("position", "velocity"):
        figure = over_quantity(series, PLACE, quantity, "rad")
        assert max(row[5] for row in figure.table.values.rows) == pytest.approx(
            most, rel=1e-9
        )


def test_many_logs_show_the_worst_only(tmp_path: Path) -> None:
    logs = tuple(f"v/{k}.parquet" for k in range(8))
    prediction = prediction_file()
    entry = prediction.logs[0]
    error = prediction.joints["elbow"]
    prediction.logs = []
    for k, path in enumerate(logs):
        joints = dict.fromkeys(JOINTS, replace(error, relative_rmse=0.01 * (k + 1)))
        of_log = replace(entry, path=path, sha256=path.ljust(64, "0"), joints=joints)
        prediction.logs.append(of_log)
    documents = [
        source("inertia.json", inertia_file()),
        source("prediction.json", prediction),
    ]
    torques = write_torques(tmp_path / "t.parquet", logs=logs)
    html = make_report(documents, torques=[torques]).html
    assert "the 3 of 8 logs with the largest errors" in html
    drawn = [path for path in logs if f"<figcaption>{path}</figcaption>" in html]
    assert drawn == list(logs[5:])
