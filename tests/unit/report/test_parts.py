"""Parts of the page: words, numbers, IMUs, payloads and plans, and the page of a fleet."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seqid_cli.compare import compare
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.document import now, tool
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    JointWithPayload,
    Measured,
    PayloadFile,
)
from seqid_cli.params.results.plan import (
    PLAN_SCHEMA,
    FourierMotion,
    JointLimits,
    PlanFile,
    PlannedMove,
    PlannedStage,
    PredictedParameter,
)
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import MotionUse, ParameterFile, Verdict
from seqid_cli.report.collection import collect
from seqid_cli.report.figures.torque import extremes, pieces
from seqid_cli.report.fleet import fleet_page
from seqid_cli.report.make import make_report
from seqid_cli.report.words import (
    DASH,
    command,
    expression,
    interval,
    listed,
    number,
    percent,
    symbol,
    unit_text,
    with_error,
)
from tests.unit.params.documents import JOINTS, full_file, inertia_file, log, robot
from tests.unit.report.pages import good_documents, made_with, prediction_file, source

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


def test_numbers_carry_as_many_digits_as_their_error() -> None:
    assert with_error(1.234567, 0.0123) == ("1.235", "0.012")
    assert with_error(-4.21669, 0.00283) == ("\u22124.2167", "0.0028")
    assert with_error(2.0, 0.0) == ("2.0000", "0")
    assert interval(1.0, 0.1) == "0.80 to 1.20"
    assert interval(1.0, 0.0) == "\u2013"
    assert number(None) == number(float("nan")) == "\u2013"
    assert number(-1.5e-7) == "\u22121.50e\u22127"
    assert number(1234567.0) == "1.23e6"
    assert percent(0.0234) == "2.3 %"


def test_expressions_are_formulas_with_lowered_indices() -> None:
    text = expression({"Izz_2": 1.0, "m_3": -0.425, "mx_3": 2.0}, "")
    assert text == (
        "<i>I</i><sub>zz\u202f2</sub> \u2212 0.425\u202f<i>m</i><sub>3</sub>"
        " + 2\u202f<i>m</i>x<sub>3</sub>"
    )
    assert expression({}, "<b>") == "&lt;b&gt;"
    assert expression({"<b>_1": 1.0}, "") == "&lt;b&gt;_1"
    assert symbol("<script>") == "&lt;script&gt;"


def test_units_lists_and_commands_in_words() -> None:
    assert unit_text("kg m^2") == "kg\u202fm\u00b2"
    assert unit_text("1") == ""
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(list("abcdefgh"), 2) == "a, b and 6 more"
    assert command("seqid", "predict", "LOG...", "-p", "a b.json") == (
        "seqid predict LOG... -p 'a b.json'"
    )
    pairs = itertools.product(("rad/s^2", "N m"), repeat=1)
    assert [unit_text(unit) for (unit,) in pairs] == ["rad/s\u00b2", "N\u202fm"]


def test_the_worst_robot_leads_and_gives_the_verdict() -> None:
    parameters, _ = good_documents()
    poor = made_with(prediction_file(shares=(0.02, 0.5)), parameters)
    robots = {
        "cell <1>": good_documents(),
        "cell 2": [parameters, source("prediction.json", poor)],
        "cell 3": [parameters],
    }
    page = fleet_page(robots)
    judgement = page.judgement
    assert judgement.level == "poor"
    assert judgement.sentence == ("3 robots. Poor: cell 2; not judged yet: cell 3; good: cell <1>.")
    assert [point.text for point in judgement.points] == ["elbow: misses 50%"]
    assert [group.title for group in page.sections[1].groups] == ["cell 2", "cell 3", "cell <1>"]
    links = re.findall(r'<a href="#(robot-[0-9])">([^<]*)</a>', page.html)
    assert links == [("robot-1", "cell 2"), ("robot-2", "cell 3"), ("robot-3", "cell &lt;1&gt;")]
    for place, name in links:
        assert re.search(rf'id="{place}-title">{re.escape(name)}</h3>', page.html)
    table = page.html.split("Models and their errors</span>")[1].split("</table>")[0]
    cells = re.findall(r'<td class="n">([^<]*)</td>', table)
    assert cells == ["50.0 %", "1", DASH, "1", "5.0 %", "0"]


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


def page(*uses: MotionUse) -> str:
    file: ParameterFile = full_file()
    file.stages.inertia.motion_use = list(uses)
    return make_report([source("inertia.json", file)]).html


def test_motion_of_every_log_with_its_errors() -> None:
    text = page(used("inertia/a.parquet"), used("inertia/b.parquet", "imu_a is not recorded"))
    assert "Where the motion of the inertia logs came from" in text
    for expected in ("inertia/a.parquet", "fused", "0.012", "0.99", "rad/s\u00b2"):
        assert expected in text
    assert "imu_a is not recorded (inertia/b.parquet)" in text


def test_the_same_remark_on_many_logs_is_one() -> None:
    text = page(*(used(f"{name}.parquet", "imu_a is left out") for name in "ab"))
    assert text.count("imu_a is left out") == 1
    assert "imu_a is left out (a.parquet, b.parquet)" in text


def test_nothing_of_it_without_motion() -> None:
    assert "Where the motion of the inertia logs" not in page()


def payload_file(used: FileId) -> PayloadFile:
    joint = JointWithPayload(
        before=2.5, after=0.125, relative=0.0625, samples=100, friction_change=0.04
    )
    return PayloadFile(
        schema=PAYLOAD_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot(),
        inputs=[log("loaded.parquet", "")],
        models=[used],
        payload=CarriedBodyEntry(
            frame="of joint elbow",
            mass=Measured(value=2.345, std_error=0.012, unit="kg"),
            center_of_mass=[
                Measured(value=0.01, std_error=0.001, unit="m"),
                Measured(value=0.02, std_error=0.001, unit="m"),
                Measured(value=None, std_error=None, unit="m"),
            ],
        ),
        parameters=[],
        covariance=[],
        settings={"urscript": "set_payload(2.345, [0.01, 0.02, 0.0])"},
        joints=dict.fromkeys(JOINTS, joint),
        verdicts=[Verdict(good=True, reason="mass 2.345 kg, standard error 0.012 kg")],
        notes=["friction differs from the model's"],
    )


def plan_file() -> PlanFile:
    move = PlannedMove(
        name="pair_1",
        stage="inertia",
        joints=list(JOINTS),
        duration_s=8.0,
        start=dict.fromkeys(JOINTS, 0.0),
        fourier={JOINTS[0]: FourierMotion(centre=0.0, sine=[0.5] * 5, cosine=[0.0] * 5)},
        torque_share=0.625,
        torque={name: [10.0, 20.0] for name in JOINTS},
    )
    limit = JointLimits(position=[-1.0, 1.0], speed=1.0, acceleration=2.0, torque=40.0, moves=True)
    error = PredictedParameter(
        name="Izz_2", joint="elbow", unit="kg m^2", std_error=0.0375, value=None
    )
    return PlanFile(
        schema=PLAN_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot(),
        what="inertia",
        seed=1,
        parameters=[],
        limits=dict.fromkeys(JOINTS, limit),
        noise_density=dict.fromkeys(JOINTS, 0.01),
        noise_origin="",
        moves=[move],
        stages={"inertia": PlannedStage(parameters=[error], rank=9, structural_rank=10)},
        duration_s=8.0,
        total_s=12.0,
    )


def test_a_payload_has_a_section_with_its_settings() -> None:
    parameters, prediction = good_documents()
    used = FileId(path=parameters.path, sha256=parameters.sha256)
    extra = [source("payload.json", payload_file(used)), source("plan.json", plan_file())]
    made = make_report([parameters, prediction, *extra])
    assert [section.id for section in made.sections][-2:] == ["payload", "plan"]
    for text in ("2.345", "not determined", "set_payload(2.345", "of joint elbow"):
        assert text in made.html
    for text in ("pair_1", "0.0375", "9 of 10", "62.5", "torque over its limit"):
        assert text in made.html


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
