import json
from pathlib import Path

import pytest

from seqid_cli.params.encode import encode
from tests.commands.conftest import Rig
from tests.unit.params.documents import diagnosis_file, inertia_file
from tests.unit.report.pages import (
    all_documents,
    good_documents,
    made_with,
    prediction_file,
    source,
    write_documents,
    write_torques,
)


@pytest.fixture
def good(rig: Rig) -> list[str]:
    """Return the names of files with nothing against them."""
    return write_documents(rig.folder, good_documents())


def test_a_page_is_written_and_summed_up(rig: Rig, good: list[str]) -> None:
    done = rig.run("report", *good, "-o", "report.html")
    assert done.code == 0
    assert done.out.startswith("Good. On 2 logs")
    assert "written: report.html" in done.err
    assert "which command gives their data: torque" in done.err
    page = (rig.folder / "report.html").read_text(encoding="utf-8")
    assert page.lstrip().startswith("<!doctype html>")
    assert "</html>" in page


def test_json_sums_up(rig: Rig, good: list[str]) -> None:
    write_torques(rig.folder / "t.parquet")
    done = rig.run("report", *good, "t.parquet", "-o", "report.html", "--json")
    document = json.loads(done.out)
    assert document["output"] == "report.html"
    assert document["verdict"] == "good"
    assert document["robot"] == "arm"
    assert document["points"] == []
    assert document["torques"] == "t.parquet"
    assert document["files"] == good
    assert {"id": "torque", "complete": True} in document["sections"]
    assert {"id": "loop", "complete": False} in document["sections"]
    assert document["bytes"] == (rig.folder / "report.html").stat().st_size


def test_torques_are_named_or_found(rig: Rig, good: list[str]) -> None:
    write_torques(rig.folder / "torques.parquet")
    found = json.loads(rig.run("report", *good, "-o", "r.html", "--json").out)
    assert found["torques"] == "torques.parquet"
    write_torques(rig.folder / "other.parquet")
    named = rig.run("report", *good, "--torques", "other.parquet", "-o", "r.html", "--json")
    assert json.loads(named.out)["torques"] == "other.parquet"
    both = rig.run("report", *good, "torques.parquet", "--torques", "other.parquet", "-o", "r.html")
    assert both.code == 2
    assert "torques.parquet, other.parquet" in both.err


def test_strict_asks_for_a_good_verdict(rig: Rig, good: list[str]) -> None:
    assert rig.run("report", *good, "-o", "r.html", "--strict").code == 0
    assert rig.run("report", good[0], "-o", "r.html", "--strict").code == 1
    assert rig.run("report", good[0], "-o", "r.html").code == 0
    assert (rig.folder / "r.html").exists()


def test_two_robots_leave_the_old_page(rig: Rig, good: list[str]) -> None:
    other = diagnosis_file()
    other.robot.name = "another"
    (rig.folder / "other.json").write_text(encode(other))
    (rig.folder / "r.html").write_text("old")
    done = rig.run("report", *good, "other.json", "-o", "r.html")
    assert done.code == 2
    for word in ("other.json", "'another'", "inertia.json", "'arm'"):
        assert word in done.err
    assert (rig.folder / "r.html").read_text() == "old"
    assert not list(rig.folder.glob(".*.tmp"))


def test_a_fleet_has_a_page_of_its_own(rig: Rig) -> None:
    names = []
    for cell in ("cell_1", "cell_2"):
        (rig.folder / cell).mkdir()
        names += [f"{cell}/{name}" for name in write_documents(rig.folder / cell, good_documents())]
    done = rig.run("report", *names, "--by", "folder", "-o", "r.html", "--json")
    document = json.loads(done.out)
    assert (document["robot"], document["verdict"]) == ("cell_1, cell_2", "good")
    assert document["sentence"] == "2 robots. Good: cell_1 and cell_2."
    write_torques(rig.folder / "t.parquet")
    refused = rig.run("report", *names, "t.parquet", "--by", "folder", "-o", "r.html")
    assert refused.code == 2
    assert "t.parquet: torques over time are drawn on the page of one robot" in refused.err


def test_a_stale_prediction_is_refused(rig: Rig) -> None:
    parameters = source("inertia.json", inertia_file())
    stale = prediction_file()
    stale = made_with(stale, source("inertia.json", diagnosis_file()))
    write_documents(rig.folder, [parameters, source("prediction.json", stale)])
    done = rig.run("report", "inertia.json", "prediction.json", "-o", "r.html")
    assert done.code == 2
    assert "prediction.json: was made with inertia.json as it was before" in done.err
    assert "Run seqid predict again" in done.err


def test_an_input_is_never_overwritten(rig: Rig, good: list[str]) -> None:
    before = (rig.folder / good[0]).read_bytes()
    done = rig.run("report", *good, "-o", good[0])
    assert done.code == 2
    assert (rig.folder / good[0]).read_bytes() == before


def test_unknown_files_are_named(rig: Rig, good: list[str]) -> None:
    assert rig.run("report", "a.parquet", "-o", "r.html").code == 2
    done = rig.run("report", good[0], "none.json", "-o", "r.html")
    assert done.code == 2
    assert "none.json: does not exist" in done.err
    (rig.folder / "trend.json").write_text('{"schema": "seqid/trend@1"}')
    done = rig.run("report", good[0], "trend.json", "-o", "r.html")
    assert "trend.json: is a trend file" in done.err
    assert rig.run("report", "-o", "r.html").code == 2
    assert rig.run("report", good[0]).code == 2


def test_everything_together(rig: Rig) -> None:
    names = write_documents(rig.folder, all_documents())
    write_torques(rig.folder / "torques.parquet")
    done = rig.run("report", *names, "-o", "r.html", "--json", "--title", "Arm of the lab")
    document = json.loads(done.out)
    assert all(section["complete"] for section in document["sections"])
    assert document["verdict"] == "reservations"
    assert "<h1>Arm of the lab</h1>" in Path(rig.folder / "r.html").read_text(encoding="utf-8")
    assert document["bytes"] < 1_000_000
