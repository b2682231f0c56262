"""Figures and tables of a report as files that stand alone."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from markupsafe import Markup

from seqid_cli.errors import ConfigError, SeqidWarning, UsageError
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import EffectOfJoint, Parameter, SpeedLevel, Verdict
from seqid_cli.report import report, standalone
from seqid_cli.report.collection import Place
from seqid_cli.report.latex import parameter_table
from seqid_cli.report.make import make_report
from seqid_cli.report.sections.correlation import correlation_figure
from seqid_cli.report.sections.friction import _points_at, friction_figures
from seqid_cli.report.views import Figure
from seqid_cli.report.words import Z95
from tests.unit.params.documents import friction_file, full_file, rigid_stage
from tests.unit.report.pages import plan_file, source

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def parameters(tmp_path: Path) -> Path:
    path = tmp_path / "refined.json"
    path.write_text(encode(full_file()))
    return path


def test_each_figure_is_a_file_of_its_own(
    parameters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With PDF beside SVG, by whatever converts it."""
    monkeypatch.setattr(standalone, "_converter", lambda: lambda svg: svg.encode()[:9])
    folder = tmp_path / "new" / "figures"
    file = report(parameters, tmp_path / "report.html", figures=folder)
    paths = [Path(path) for path in file.figures]
    assert sorted(paths) == sorted(folder.iterdir())
    drawings = [path for path in paths if path.suffix == ".svg"]
    assert drawings
    assert {path.stem for path in drawings} == {
        path.stem for path in paths if path.suffix == ".pdf"
    }
    assert drawings[0].with_suffix(".pdf").read_bytes() == b"<svg xmln"
    assert paths[-1].name == "parameters.tex"


def test_a_figure_needs_nothing_else(
    parameters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its colours and its legend are in it; nothing is fetched and nothing is run."""
    monkeypatch.setattr(standalone, "_converter", lambda: None)
    with pytest.warns(SeqidWarning, match="pip install"):
        file = report(parameters, tmp_path / "report.html", figures=tmp_path / "f")
    (path,) = (path for path in file.figures if path.endswith("-1-over-velocity.svg"))
    text = Path(path).read_text()
    for word in ("var(", "@media", "url(", "<script", "href"):
        assert word not in text
    root = ElementTree.fromstring(text)
    texts = [item.text for item in root.findall(f"{SVG}text")]
    assert len(texts) == 3
    assert all(item.startswith("at ") for item in texts)
    marks = [item.get("class") for item in root.findall(f"{SVG}line")]
    assert marks == ["key cut0", "key cut1", "key cut2"]
    for name in marks:
        rule = "." + name.replace(" ", ".")
        assert re.search(re.escape(rule) + r"\{color:#[0-9a-f]{6}\}", text)


def _drawing(**legend: str) -> Figure:
    drawing = Markup('<svg class="plot" viewBox="0 0 372 266"></svg>')
    return Figure(title="t", drawing=drawing, legend=legend)


def test_a_long_legend_takes_more_rows() -> None:
    one = ElementTree.fromstring(standalone.standalone(_drawing(measured="a")))
    long = {f"cut{k}": "a line with a long name of its own" for k in range(3)}
    three = ElementTree.fromstring(standalone.standalone(_drawing(**long)))
    assert float(one.get("height")) == 266 + 18
    assert float(three.get("height")) == 266 + 3 * 18
    assert len({item.get("y") for item in three.findall(f"{SVG}text")}) == 3


def test_names_of_files_never_leave_the_folder(tmp_path: Path) -> None:
    assert standalone._slug("../../etc", "Über <b>") == "etc-ber-b"
    assert standalone._slug("..") == "figure"
    path = tmp_path / "a.svg"
    second = standalone._free(path, [path])
    assert standalone._free(path, [path, second]).name == "a-3.svg"


def test_a_folder_that_cannot_be_made_is_said(parameters: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(UsageError, match="cannot be written"):
        report(parameters, tmp_path / "r.html", figures=tmp_path / "taken")


def test_the_table_is_latex() -> None:
    file = full_file()
    file.robot.name = "a_b\n\\input{x}"
    stage = file.stages.inertia
    stage.parameters = [
        Parameter(
            name="Ixx_2",
            value=-1.23456e-7,
            std_error=2e-12,
            unit="kg m^2",
            terms={"Ixx_2": 1.0, "m_3": -0.25, "mx_3": 2.0},
        )
    ]
    file.stages.effects = [
        EffectOfJoint(
            effect="torque_bias",
            joint="el_bow&",
            parameters=[Parameter(name="bias", value=1.5, std_error=1e31, unit="%")],
        )
    ]
    text = parameter_table(file)
    head, *lines = text.splitlines()
    assert head.startswith("% a_b \\input{x}, by seqid")
    assert any("\\begin{tabular}" in line for line in lines)
    row = next(line for line in lines if line.startswith("$I_{xx,2}$"))
    assert r"\cdot 10^{-7}$" in row
    assert r"kg\,m\textsuperscript{2}" in row
    assert r"$I_{xx,2} - 0.25\,m_{3} + 2\,m x_{3}$" in row
    assert any(r"torque bias at el\_bow\&" in line for line in lines)
    assert any(r"-- & not determined & \%" in line for line in lines)
    opened, closed = text.count("{"), text.count("}")
    assert opened == closed


def test_measured_points_stand_beside_the_curves(tmp_path: Path) -> None:
    """Each at the surface, plus what was measured more, with its interval."""
    file = friction_file()
    for name, joint in file.stages.friction.joints.items():
        points = [[0.9, 1.0, 0.2, 0.05], [1.1, 1.0, 0.4, 0.05], [-1.0, -1.0, 0.3, 0.1]]
        joint.speeds = [
            SpeedLevel(speed=0.8, forward=2, backward=1, rmse=0.1, points=points)
        ]
        place = Place(joint=name, unit="N m", length="rad")
        over_velocity = friction_figures(joint, place)[1]
        drawing = ElementTree.fromstring(over_velocity.drawing)
        found = [item.get("class") for item in drawing.iter("circle")]
        # The cuts are at -1, 0 and 1 rad; a quarter of their distance is within reach.
        assert found == ["point cut0", "point cut2"]
        assert len(list(drawing.iter("circle"))) == len(
            [item for item in drawing.iter("line") if "bar-of" in item.get("class")]
        )
        surface = FrictionSurface.from_stage(joint)
        back, forth = (float(item.get("cx")) for item in drawing.iter("circle"))
        assert back < forth
        cut = _points_at(joint, surface, 1.0, over_velocity=True)
        at_cut = surface.torque(np.array([1.0]), np.array([0.8]))
        assert cut.torque == pytest.approx(at_cut + 0.3)
        assert cut.half_width == pytest.approx([Z95 * 0.05])
        assert "Points" in over_velocity.note


def test_points_of_another_shape_are_refused(tmp_path: Path) -> None:
    file = friction_file()
    joint = next(iter(file.stages.friction.joints.values()))
    joint.speeds = [
        SpeedLevel(speed=0.8, forward=1, backward=1, rmse=0.1, points=[[1.0, 2.0]])
    ]
    path = tmp_path / "friction.json"
    path.write_text(encode(file))
    with pytest.raises(ConfigError, match=r"speeds\[0\].points: must have rows of 4"):
        read_parameters(path)


def test_correlations_are_drawn_and_the_strongest_told() -> None:
    stage = rigid_stage()
    stage.parameters = [
        Parameter(name=name, value=1.0, std_error=0.1, unit="kg m")
        for name in ("mx_1", "my_1", "mx_2")
    ]
    assert correlation_figure(stage, "Gravity") is None  # no covariance of three
    correlation = np.array([[1.0, -0.95, 0.05], [-0.95, 1.0, 0.5], [0.05, 0.5, 1.0]])
    deviations = np.array([0.1, 2.0, 30.0])
    stage.covariance = (correlation * np.outer(deviations, deviations)).tolist()
    drawn = correlation_figure(stage, "Gravity")
    cells = list(ElementTree.fromstring(drawn.drawing).iter("rect"))
    assert [cell.get("class") for cell in cells] == ["cell minus", "cell plus"]
    assert [cell.get("fill-opacity") for cell in cells] == ["0.95", "0.50"]
    assert "my_1 with mx_1" in drawn.note
    assert [list(row)[:2] for row in drawn.table.rows] == [["my_1", "mx_1"]]
    stage.covariance[0][0] = 0.0
    assert correlation_figure(stage, "Gravity") is None


def test_a_plan_alone_is_a_page_of_plans() -> None:
    """No section on what nobody gave, and the plan's own verdict."""
    file = plan_file()
    page = make_report([source("plan.json", file)])
    assert [section.id for section in page.sections] == ["verdict", "pipeline", "plan"]
    assert page.judgement.level == "good"
    assert "What to record next" in page.html
    file.verdicts = [Verdict(joint="", good=False, reason="rank 3 of 4")]
    poor = make_report([source("plan.json", file)])
    assert poor.judgement.level == "poor"
    assert poor.judgement.sentence == "Rank 3 of 4."


def test_a_page_is_no_pdf(parameters: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="web page") as raised:
        report(parameters, tmp_path / "report.pdf")
    assert "print it" in raised.value.hint
    assert not (tmp_path / "report.pdf").exists()
