"""What the pages say, to the letter: words and tables; drawings by their descriptions."""

import re
from html import unescape
from pathlib import Path

import pytest

from seqid_cli import __version__
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import MotionUse, RigidStage
from seqid_cli.report.fleet import fleet_page
from seqid_cli.report.make import make_report
from seqid_cli.report.views import Page
from tests.transcripts import check_text
from tests.unit.params.documents import friction_file, inertia_file
from tests.unit.report.pages import (
    all_documents,
    good_documents,
    made_with,
    payload_file,
    plan_file,
    prediction_file,
    source,
    write_torques,
)

BREAKS = {"h2": "\n# ", "h3": "\n## ", "tr|li|p|caption|figcaption|details|pre": "\n"}


def text_of(page: Page) -> str:
    """The text of a page in lines, with the first rows of the tables below its figures."""
    text = page.html.partition("</nav>")[2].partition("</main>")[0]
    text = re.sub(r'<svg class="marks".*?</svg>', "", text, flags=re.DOTALL)
    text = re.sub(r"<svg.*?<desc>(.*?)</desc>.*?</svg>", r"[\1]", text, flags=re.DOTALL)
    for figure in re.findall(r"<figure.*?</figure>", text, flags=re.DOTALL):
        shown, _, values = figure.partition("<details>")
        rows = re.findall(r"<tr>.*?</tr>", values, flags=re.DOTALL)
        text = text.replace(figure, shown + "".join(rows[:3]))
    text = re.sub(r"\s*\n\s*", " ", text)
    for tags, mark in BREAKS.items():
        text = re.sub(rf"<({tags})\b", rf"{mark}<\1", text)
    text = re.sub(r'<span class="badge (\w+)">', r" (\1) ", text)
    text = re.sub(r"</(td|th|dd)>", " | ", text).replace("</dt>", ": ")
    text = unescape(re.sub(r"<[^>]*>", "", text)).replace(f"seqid {__version__}", "seqid")
    text = re.sub(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", "DATE", text)
    text = re.sub(r"\b[0-9a-f]{12}(?:[0-9a-f]{52})?\b", "HASH", text)
    return "\n".join(line.strip(" |") for line in text.splitlines()) + "\n"


def used(log: str, *warnings: str) -> MotionUse:
    return MotionUse(
        log=log,
        source="fused" if not warnings else "encoder",
        imus=[] if warnings else ["imu_a"],
        cutoff_hz=20.0,
        acceleration_error={"shoulder": 0.0123},
        encoder_error={"shoulder": 0.987},
        warnings=list(warnings),
    )


def everything(folder: Path) -> Page:
    """All kinds of documents, and torques."""
    parameters, *documents, refined = all_documents()
    lost = [used(f"{name}.parquet", "imu_a is not recorded") for name in "bc"]
    refined.content.stages.inertia.motion_use = [used("inertia/a.parquet"), *lost]  # type: ignore
    of = FileId(path=parameters.path, sha256=parameters.sha256)
    more = [source("payload.json", payload_file(of)), source("plan.json", plan_file())]
    torques = [write_torques(folder / "t.parquet")]
    return make_report([parameters, *documents, refined, *more], torques=torques, title="An arm")


def parameters_alone(folder: Path) -> Page:
    """Of a planar arm; what is missing comes with its command."""
    file = inertia_file()
    note = "gravity loads no joint"
    file.stages.gravity = RigidStage(parameters=[], condition=0.0, rank=0, notes=[note])
    return make_report([source("inertia.json", file)])


def friction_of_sliding_joint(folder: Path) -> Page:
    file = friction_file()
    file.robot.prismatic = ["elbow"]
    return make_report([source("friction.json", file)])


def fleet(folder: Path) -> Page:
    parameters, _ = good_documents()
    poor = made_with(prediction_file(shares=(0.02, 0.5)), parameters)
    robots = {
        "cell <1>": good_documents(),
        "cell 2": [parameters, source("prediction.json", poor)],
        "cell 3": [parameters],
    }
    return fleet_page(robots)


PAGES = (everything, parameters_alone, friction_of_sliding_joint, fleet)


@pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)
def test_pages_say_what_they_said(make: object, tmp_path: Path) -> None:
    assert callable(make)
    path = Path(__file__).with_name("texts") / f"{make.__name__}.txt"
    check_text(path, text_of(make(tmp_path)))
