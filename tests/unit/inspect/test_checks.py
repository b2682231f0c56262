"""Checks on their own numbers, which stages logs serve, and the documents' table of
codes.
"""

import re
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from seqid_cli.inspect.dynamics.friction import Sample, scaled_fit, scaled_residual
from seqid_cli.inspect.dynamics.structure import structural_error
from seqid_cli.inspect.findings import ERRORS, WARNINGS
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.inspect.serves import serve_together
from seqid_cli.params.results.inspection import InspectedLog
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import inverse_dynamics
from tests import ROOT
from tests.plants.robots.small import arm_6r
from tests.unit.inspect.faults import SAMPLES, SIX, read_columns, write_columns
from tests.unit.logs.samples import make_robot

WAVES = pytest.param("validation/fourier_1", marks=pytest.mark.slow)


@pytest.mark.parametrize("log", [WAVES, "inertia/shoulder_lift__elbow"])
def test_a_driver_that_subtracts_gravity_is_told_from_a_mounting(
    tmp_path: Path, log: str
) -> None:
    folder = SAMPLES / "six_joint"
    robot = load_robot(folder / "robot.toml")
    columns = read_columns(folder / f"{log}.parquet")
    q = np.column_stack([columns[f"{name}.position"] for name in SIX])
    weight = inverse_dynamics(
        robot.chain, robot.gravity, robot.nominal, q, 0.0 * q, 0.0 * q
    )
    for joint, own in zip(robot.joints, weight.T, strict=True):
        current = columns.pop(f"{joint.name}.current")
        columns[f"{joint.name}.torque"] = current * joint.torque_per_ampere - own
    write_columns(tmp_path / "log.parquet", columns)
    shutil.copy(folder / "six_joint.urdf", tmp_path)
    text = (folder / "robot.toml").read_text()
    for effort, codes in (
        ("torque", {"effort_without_gravity"}),
        ("gravity_compensated", set()),
    ):
        own_text = text.replace('effort = "current"', f'effort = "{effort}"')
        (tmp_path / "robot.toml").write_text(own_text)
        found = inspect_log(
            tmp_path / "log.parquet", load_robot(tmp_path / "robot.toml")
        ).findings
        assert {finding.code for finding in found} == codes


def test_small_efforts_of_other_signs_do_not_lack_gravity(tmp_path: Path) -> None:
    """Gravity that is added to amperes dwarfs them, and what is left, by its size."""
    folder = SAMPLES / "six_joint"
    columns = read_columns(folder / "inertia/shoulder_lift__elbow.parquet")
    for name, constant in zip(SIX, (1.0, 0.4, -2.5, -0.5, 3.0, -1.5), strict=True):
        columns[f"{name}.torque"] = constant * columns.pop(f"{name}.current")
    write_columns(tmp_path / "log.parquet", columns)
    shutil.copy(folder / "six_joint.urdf", tmp_path)
    lines = (folder / "robot.toml").read_text().replace('effort = "current"', "")
    unknown = ("torque_constant", "gear_ratio", "rotor_inertia")
    kept = [line for line in lines.splitlines() if not line.startswith(unknown)]
    (tmp_path / "robot.toml").write_text("\n".join(kept))

    robot = load_robot(tmp_path / "robot.toml")
    found = inspect_log(tmp_path / "log.parquet", robot).findings
    codes = {finding.code for finding in found}
    assert "effort_without_gravity" not in codes
    assert "sign_mismatch" in codes


def test_searches_for_causes_work_out_no_inverse(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They ask for the residual alone, hundreds of times; and get the same one."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 6))
    X[:, 3] = X[:, 1] - X[:, 2]
    X[:, 4] = 0.0
    X[:, 5] *= 1e-5
    y = rng.normal(size=200)
    expected = scaled_fit(X, y).residual

    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(np.linalg, "pinv", refused)
    np.testing.assert_allclose(scaled_residual(X, y), expected, rtol=0.0, atol=1e-13)

    chain = arm_6r()
    q, dq, ddq, tau = rng.normal(size=(4, 300, chain.n))
    sample = Sample(
        robot=chain,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=tau,
        direction=np.sign(dq),
        memory=1.0,
        moving=tuple(range(chain.n)),
        basis=base_parameters(chain, rotor=()),
    )
    assert 0.5 < structural_error(sample) < 1.0


@pytest.mark.slow
def test_torques_of_the_other_sign_have_one_remedy(tmp_path: Path) -> None:
    """Sensors without friction show it by their weights alone."""
    folder = SAMPLES / "six_joint"
    robot = load_robot(folder / "robot.toml")
    t = np.arange(0.0, 20.0, 0.01)
    rates = np.array([2.7, 2.9, 3.1, 3.3, 3.5, 3.7])
    start = np.array([0.0, -1.2, 0.5, 0.0, 0.0, 0.0])
    q = start + 0.6 * np.sin(np.outer(t, rates))
    dq = 0.6 * rates * np.cos(np.outer(t, rates))
    ddq = -0.6 * rates**2 * np.sin(np.outer(t, rates))
    tau = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, dq, ddq)
    noise = np.random.default_rng(3).normal(0.0, 0.3, tau.shape)
    columns = {"t": t}
    for j, name in enumerate(SIX):
        columns[f"{name}.position"] = q[:, j]
        columns[f"{name}.torque"] = -1.2 * tau[:, j] + noise[:, j]
    write_columns(tmp_path / "log.parquet", columns)
    shutil.copy(folder / "six_joint.urdf", tmp_path)
    text = (folder / "robot.toml").read_text()
    (tmp_path / "robot.toml").write_text(
        text.replace('effort = "current"', 'effort = "torque"')
    )

    found = inspect_log(
        tmp_path / "log.parquet", load_robot(tmp_path / "robot.toml")
    ).findings
    signs = [finding for finding in found if finding.code == "sign_mismatch"]
    assert signs
    assert not any(finding.code == "axis_flipped" for finding in found)
    assert all("gear_ratio = -1" in finding.remedy for finding in signs)


@pytest.mark.parametrize("lost", [0, 80])
def test_the_hole_between_episodes_is_no_gap(tmp_path: Path, lost: int) -> None:
    t, episode = (
        np.tile(np.arange(0.0, 10.0, 0.01), 3),
        np.repeat([0.0, 1.0, 2.0], 1000),
    )
    kept = np.delete(np.arange(3000), slice(1500, 1500 + lost))
    table = {
        "t": t,
        "episode_index": episode,
        "a.position": np.round(np.sin(t) / 1e-4) * 1e-4,
        "a.torque": np.cos(1.3 * t) + 0.5 * np.sign(np.cos(t)),
    }
    write_columns(
        tmp_path / "log.parquet", {name: x[kept] for name, x in table.items()}
    )
    found = [
        f
        for f in inspect_log(tmp_path / "log.parquet").findings
        if f.code == "clock_gap"
    ]
    assert [f.message.split(",")[0] for f in found] == ["1 gaps"] * bool(lost)


ROW = re.compile(
    r"^\| `(\w+)` \| (error|warning) \| [^|]+ \| [^|]+ \| ([^|]+) \|$", re.MULTILINE
)


def test_the_table_of_codes_is_the_packages_own() -> None:
    rows = sorted(ROW.findall((ROOT / "docs" / "reference" / "inspect.md").read_text()))
    kinds = (("error", ERRORS), ("warning", WARNINGS))
    assert rows == sorted(
        (code, kind, own[code]) for kind, own in kinds for code in own
    )


def log(
    speed: float, *serves: str, backward: int = 1, effort: str = "torque"
) -> InspectedLog:
    joint = {"name": "elbow", "moves": True, "low": -1.0, "high": 1.0, "top_speed": 1.0}
    joint |= {
        "effort": effort,
        "encoder_step": None,
        "effort_rms": None,
        "temperature": None,
    }
    moves = {"joint": "elbow", "forward": 1, "backward": backward, "postures": 1}
    moves |= {"slowest": speed, "fastest": speed}
    known = {"path": f"{speed}", "sha256": "", "format": "csv", "verdict": "good"}
    known |= {"joints": [joint], "moves": [moves], "serves": serves}
    return msgspec.convert(known, InspectedLog)


@pytest.mark.parametrize(
    ("third", "served"),
    [
        (log(0.4), ["friction", "friction", "friction"]),
        (log(0.21), ["", "", ""]),
        (log(0.4, backward=0), ["", "", ""]),
        (log(0.4, effort=""), ["", "", ""]),
        (log(0.4, "friction"), ["", "", "friction"]),
    ],
    ids=["one log per speed", "two speeds", "one way", "no torque", "one serves alone"],
)
def test_logs_serve_friction_together(third: InspectedLog, served: list[str]) -> None:
    found = serve_together([log(0.1, "gravity"), log(0.2), third])
    assert [" ".join(one.serves) for one in found] == [
        f"{served[0]} gravity".strip(),
        *served[1:],
    ]


def test_an_arm_without_dynamics_is_inspected_too(tmp_path: Path) -> None:
    """No torque of it depends on a position, so that no zero can be told."""
    t = np.arange(0.0, 6.0, 0.01)
    waves = {f"{name}.position": np.sin(t + k) for k, name in enumerate("ab")}
    waves |= {f"{name}.torque": np.cos(t + k) for k, name in enumerate("ab")}
    write_columns(tmp_path / "log.parquet", {"t": t} | waves)
    robot = make_robot(("a", "b"))
    codes = {f.code for f in inspect_log(tmp_path / "log.parquet", robot).findings}
    assert "unreadable" not in codes
    assert "position_zero" not in codes
