"""When two results count as different, and when not."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.compare.differences import compared as compared_by
from seqid_cli.compare.differences import rule_of
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.comparison import ComparisonFile, RuleEntry
from seqid_cli.params.schema import EffectOfJoint, Parameter, ParameterFile, Verdict
from tests.transcripts import check_text
from tests.unit.params.documents import diagnosis_file, full_file, inertia_file
from tests.unit.report.pages import prediction_file

DEFAULT = rule_of(None, None)
Edit = Callable[[ParameterFile, ParameterFile], None]


def compared(a: Document, b: Document, rule: RuleEntry = DEFAULT) -> ComparisonFile:
    return compared_by(Source("a.json", "0", a), Source("b.json", "1", b), rule)


def parameters(file: ParameterFile) -> list[Parameter]:
    return file.stages.gravity.parameters


@pytest.mark.parametrize(
    ("moved", "error", "sigma", "rtol", "different"),
    [
        (0.10, 0.01, None, None, True),  # 7 standard errors and 8 %
        (0.05, 0.02, None, None, False),  # 4 %, but within 4 standard errors
        (0.005, 1e-5, None, None, False),  # far beyond its errors, but 0.4 %
        (0.05, 0.02, None, 0.01, True),  # rtol alone decides
        (0.005, 1e-5, None, 0.01, False),
        (0.005, 1e-5, 4.0, None, True),  # sigma alone decides
        (1e-9, 1e-12, 4.0, None, False),  # but never below rounding
        (0.05, 0.02, 1.0, 0.5, False),  # both must be exceeded
        (0.05, 0.02, 1.0, 0.01, True),
        (0.001, 0.0, None, None, False),  # no standard error: the size decides
        (0.1, 0.0, None, None, True),
    ],
)
def test_rule(
    moved: float, error: float, sigma: float | None, rtol: float | None, different: bool
) -> None:
    a, b = inertia_file(), inertia_file()
    parameters(a)[0].std_error = parameters(b)[0].std_error = error
    parameters(b)[0].value += moved
    found = compared(a, b, rule_of(sigma, rtol))
    assert bool(found.changed) == different
    change = next(item for item in found.differences if item.stage == "gravity")
    assert change.different == different
    assert change.sigmas == (
        pytest.approx(moved / (math.sqrt(2.0) * error)) if error else None
    )
    assert change.relative == pytest.approx(moved / 1.25)


def moved_surface(a: ParameterFile, b: ParameterFile) -> None:
    for file in (a, b):
        file.stages.friction.joints["elbow"].covariance = (1e-6 * np.eye(2)).tolist()
    joint = b.stages.friction.joints["elbow"]
    joint.positive = joint.negative = [[1.1], [1.0 / 3.0 + 0.1]]


def same_surface(a: ParameterFile, b: ParameterFile) -> None:
    joint = b.stages.friction.joints["elbow"]
    # 1 + x/3 with x = q / 2 becomes 1 + (2/3) x' over twice the range.
    joint.position_range = [-4.0, 4.0]
    joint.position_order, joint.velocity_order = 2, 1
    joint.positive = joint.negative = [[1.0, 0.0], [2.0 / 3.0, 0.0], [0.0, 0.0]]
    joint.covariance = (1e-8 * np.eye(6)).tolist()


def turned(euler: str, *degrees: float, free: bool = False) -> Edit:
    """Turn a mounting; where it is `free` about z no installation determines that
    angle.
    """

    def turn(a: ParameterFile, b: ParameterFile) -> None:
        one, other = (file.stages.imu.imus["imu_a"] for file in (a, b))
        if free:  # about the axis of the only joint before the IMU
            one.std_errors_deg = other.std_errors_deg = [0.01, 0.01, 140.0]
        own = Rotation.from_euler(euler, degrees, degrees=True).as_matrix()
        other.rotation = (own @ np.array(one.rotation)).tolist()

    return turn


def moved_effect(a: ParameterFile, b: ParameterFile) -> None:
    named = {
        "name": "stribeck_torque",
        "std_error": 0.01,
        "unit": "N m",
        "joint": "elbow",
    }
    for file, value in ((a, 1.0), (b, 1.2)):
        file.stages.effects[0].parameters = [Parameter(value=value, **named)]
    b.stages.effects[0].settings["stribeck_speed"] = 0.2


def poor(a: ParameterFile, b: ParameterFile) -> None:
    """Of several verdicts on a joint all must be good."""
    reasons = "no values for a while", "too few speeds"
    hole, few = (
        Verdict(joint="elbow", good=False, reason=reason) for reason in reasons
    )
    for file in (a, b):
        file.stages.gravity.verdicts = [*file.stages.gravity.verdicts, hole]
    b.stages.friction.verdicts = [*b.stages.friction.verdicts, hole, few]


def tiny(a: ParameterFile, b: ParameterFile) -> None:
    """A parameter that is really zero is a thousandth of the largest of its unit at
    least.
    """
    for file, value in ((a, 1e-8), (b, 2e-8)):
        zero = Parameter(
            name="my_1", value=value, std_error=1e-10, unit="kg m", joint="shoulder"
        )
        parameters(file).append(zero)


def other_file(a: ParameterFile, b: ParameterFile) -> None:
    b.robot.sha256 = "1" * 64
    b.stages.inertia.rotor_coupling = "gyroscopic"
    del b.stages.friction.joints["elbow"]


def of_the_second(place: str, value: object) -> Edit:
    def edit(a: ParameterFile, b: ParameterFile) -> None:
        *names, last = place.split(".")
        owner = b.stages
        for name in names:
            owner = owner[name] if isinstance(owner, dict) else getattr(owner, name)
        setattr(owner, last, value)

    return edit


SPRING = EffectOfJoint(effect="spring", joint="elbow")
CASES: dict[str, Edit] = {
    "equal": lambda a, b: None,
    "without the parameters of gravity": of_the_second("gravity.parameters", []),
    "without IMUs": of_the_second("imu", None),
    "other coefficients of the same friction": same_surface,
    "other friction": moved_surface,
    "speeds of another range": of_the_second(
        "friction.joints.elbow.speed_range", [2.0, 3.0]
    ),
    "turned by half a degree": turned("x", 0.5),
    "turned by 3 degrees": turned("x", 3.0),
    "turned about the free axis": turned("z", 143.0, free=True),
    "tilted, and turned about the free axis": turned("xz", 3.0, 143.0, free=True),
    "another parameter and setting of an effect": moved_effect,
    "another effect": of_the_second("effects", [SPRING]),
    "without effects": of_the_second("effects", None),
    "a parameter that is next to nothing": tiny,
    "another verdict": poor,
    "another robot file, rotors, and a joint less": other_file,
}


def described(found: ComparisonFile) -> Iterator[str]:
    """The numbers that moved, to five digits, and the notes; speeds of surfaces are
    left out.
    """
    for x in found.differences:
        numbers = [
            f"{n:.5g}" for n in (x.a, x.b, x.sigmas, x.relative) if n is not None
        ]
        what = " ".join(filter(None, (x.stage, x.name, x.joint)))
        if x.different or x.relative:
            kind = "changed" if x.different else "same"
            remark = x.remark.partition(", speed")[0]
            yield f"{kind}: {what}: {', '.join(numbers)} {x.unit} {remark}".rstrip()
    yield from (f"note: {note}" for note in found.notes)


def test_what_of_a_parameter_file_has_changed() -> None:
    text = ""
    for name, edit in CASES.items():
        a, b = full_file(), full_file()
        edit(a, b)
        found, back = compared(a, b), compared(b, a)
        assert (found.compared, found.changed) == (back.compared, back.changed)
        text += "\n".join(
            [f"# {name}: {found.changed} of {found.compared}", *described(found), ""]
        )
    check_text(Path(__file__).with_name("changes.txt"), text)


def test_results_are_compared_by_verdict_findings_and_errors() -> None:
    a, b = diagnosis_file(), diagnosis_file()
    assert not compared(a, b).changed
    b.verdict, b.findings, b.joints["elbow"].rmse = "nothing_missing", [], 0.4
    b.joints["elbow"].noise_floor = None
    del b.joints["shoulder"]
    assert list(described(compared(a, b))) == [
        "changed: diagnosis verdict:   effect_found, then nothing_missing",
        "changed: diagnosis stribeck elbow:   only in the first",
        "changed: diagnosis rmse elbow: 0.3, 0.4, 0.33333 N m",
        "changed: diagnosis noise_floor elbow:   only in the first",
    ]
    one, other = prediction_file(), prediction_file(shares=(0.02, 0.1))
    assert not compared(one, one).changed
    del other.joints["shoulder"]
    assert list(described(compared(one, other))) == [
        "changed: prediction joint shoulder:   only in the first",
        "changed: prediction rmse elbow: 0.1, 0.2, 1 N m",
        "changed: prediction max_abs elbow: 0.3, 0.6, 1 N m",
    ]


def test_other_kinds_and_other_robots_are_errors() -> None:
    a, b = inertia_file(), inertia_file()
    b.robot.joints = ["shoulder", "wrist"]
    with pytest.raises(ConfigError, match="is about robot 'arm' \\(shoulder, wrist\\)"):
        compared(a, b)
    with pytest.raises(UsageError, match="is a diagnosis file"):
        compared(a, diagnosis_file())
