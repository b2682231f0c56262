"""`seqid report`: the page, its summary, and files that do not belong together."""

import json

import pytest

from seqid_cli.params.encode import encode
from tests.commands.conftest import Rig
from tests.commands.transcripts import check_transcript
from tests.unit.params.documents import diagnosis_file
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


def test_what_the_user_sees(rig: Rig) -> None:
    """Of one model, of all documents, of a fleet; what is refused leaves all files as they are."""
    names = write_documents(rig.folder, all_documents())
    (rig.folder / "cell").mkdir()
    write_documents(rig.folder / "cell", good_documents())
    other = diagnosis_file()
    other.robot.name = "another"
    (rig.folder / "other.json").write_text(encode(other))
    stale = made_with(prediction_file(), source("inertia.json", diagnosis_file()))
    (rig.folder / "stale.json").write_text(encode(stale))
    (rig.folder / "trend.json").write_text('{"schema": "seqid/trend@1"}')
    for name in ("t.parquet", "torques.parquet"):
        write_torques(rig.folder / name)
    before = [(rig.folder / name).read_bytes() for name in names]
    check_transcript(rig, "report")
    assert [(rig.folder / name).read_bytes() for name in names] == before
    assert not list(rig.folder.glob(".*.tmp"))
    page = (rig.folder / "report.html").read_text(encoding="utf-8")
    assert page.lstrip().startswith("<!doctype html>")
    assert "</html>" in page


def test_json_sums_up(rig: Rig, good: list[str]) -> None:
    write_torques(rig.folder / "t.parquet")
    done = rig.run("report", *good, "t.parquet", "-o", "report.html", "--json", "--title", "An arm")
    document = json.loads(done.out)
    size = (rig.folder / "report.html").stat().st_size
    sections = document.pop("sections")
    assert {"id": "torque", "complete": True} in sections
    assert {"id": "loop", "complete": False} in sections
    assert document.pop("sentence").startswith("On 2 logs")
    assert size < 1_000_000
    assert document == {
        "output": "report.html",
        "robot": "arm",
        "verdict": "good",
        "points": [],
        "files": good,
        "torques": "t.parquet",
        "bytes": size,
    }
    assert "<h1>An arm</h1>" in (rig.folder / "report.html").read_text(encoding="utf-8")


def test_torques_are_named_or_found(rig: Rig, good: list[str]) -> None:
    for name, more in (("torques.parquet", ()), ("other.parquet", ("--torques", "other.parquet"))):
        write_torques(rig.folder / name)
        done = rig.run("report", *good, *more, "-o", "r.html", "--json")
        assert json.loads(done.out)["torques"] == name


def test_a_fleet_has_a_page_of_its_own(rig: Rig) -> None:
    for cell in ("cell_1", "cell_2"):
        (rig.folder / cell).mkdir()
        names = write_documents(rig.folder / cell, good_documents())
    files = [f"{cell}/{name}" for cell in ("cell_1", "cell_2") for name in names]
    done = rig.run("report", *files, "--by", "folder", "-o", "r.html", "--json")
    document = json.loads(done.out)
    assert (document["robot"], document["verdict"]) == ("cell_1, cell_2", "good")
    assert document["sentence"] == "2 robots. Good: cell_1 and cell_2."
