"""The study of verdicts: its arms, its logs, its truths and what it counts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from seqid_cli.robot.base_parameters import STANDARD
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import torque_regressor
from tests.studies.outside import motions
from tests.studies.outside.arms import Arm, drawn_arm
from tests.studies.outside.simulate import simulate
from tests.studies.truth import __main__ as program
from tests.studies.truth.follow import Followed, follow
from tests.studies.truth.plan import CLEAN, KINDS, Case, Imperfection, drawn, kinds_of
from tests.studies.truth.score import HANDED_ON, Row, scored
from tests.studies.truth.session import as_logged, session_of, write_robot
from tests.studies.truth.tabulate import level_of, silent_wrongs, tables
from tests.studies.truth.tolerances import TOLERANCES
from tests.studies.truth.truths import true_friction, true_nuisances, true_standard


def case_with(kind: str = "", n: int = 2, **sizes: Any) -> Case:
    """An arm without noise that is logged at every step, and one imperfection."""
    arm = drawn_arm(np.random.default_rng(5), "drawn", n, imus=False)
    drives = tuple(replace(drive, count=1e-9) for drive in arm.drives)
    arm = replace(arm, noise=0.0, rate_hz=1000.0, drives=drives)
    items = (Imperfection(kind, sizes),) if kind else ()
    return Case(label="test", seed=3, arm=arm, imperfections=items)


def test_every_kind_comes_and_three_arms_in_ten_are_clean() -> None:
    counts = [len(kinds_of(seed)) for seed in range(200)]
    assert (counts.count(0), counts.count(1), counts.count(3)) == (60, 60, 80)
    assert {kind for seed in range(15) for kind in kinds_of(seed, alone=True)} == set(
        KINDS
    )
    assert kinds_of(0, [CLEAN], alone=True) == ()
    assert set(kinds_of(9, ["delay", "tool"])) == {"delay", "tool"}
    assert all(len(set(kinds_of(seed))) == len(kinds_of(seed)) for seed in range(50))


@pytest.mark.parametrize("seeds", ["9999:10001", "10000:10002"])
def test_reserved_seeds_are_not_run_among_others(
    seeds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["truth", "--set", "tuning", "--seeds", seeds]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit):
        program.main()


def test_the_arm_follows_as_in_the_other_study() -> None:
    case = case_with()
    motion = motions.multisine(case.arm, np.random.default_rng(1), 2.0)
    followed = follow(case, motion, start=7.0)
    log = simulate(case.arm, motion, 0, start=7.0)
    np.testing.assert_allclose(followed.q, log.q, atol=1e-9)
    # The other study logs the torque of the integrator's step, which is half a step
    # beside it.
    size = np.std(log.true_torque, axis=0)
    np.testing.assert_array_less(
        np.std(followed.torque - log.true_torque, axis=0), 0.01 * size
    )


def test_motion_and_torque_are_of_one_instant(tmp_path: Path) -> None:
    """The torque of a sliding joint is that of its equation of motion, to rounding."""
    case = case_with()
    arm = case.arm
    write_robot(case, tmp_path)
    robot = load_robot(tmp_path / "robot.toml")
    motion = motions.multisine(arm, np.random.default_rng(1), 2.0)
    followed = follow(case, motion, start=0.0)

    q, step = followed.q, followed.t[1] - followed.t[0]
    behind = np.diff(q, axis=0)[:-1] / step
    ahead = np.diff(q, axis=0)[1:] / step
    dq, ddq = (behind + ahead) / 2.0, (ahead - behind) / step
    q, torque = q[1:-1], followed.torque[1:-1]

    standard = true_standard(case)
    phi = np.array(
        [standard[f"{name}_{j + 1}"] for j in range(arm.n) for name in STANDARD]
    )
    expected = torque_regressor(robot.chain, robot.gravity, q, dq, ddq) @ phi
    expected += arm.of("rotor") * ddq
    for j in range(arm.n):
        expected[:, j] += true_friction(case, j, q[:, j], dq[:, j], 0.0)
    slides = np.abs(dq) > 0.1
    assert slides.mean() > 0.5
    assert np.abs(torque - expected)[slides].max() < 1e-7 * np.abs(torque).max()


def logged_torque(arm: Case, torque: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    t = np.arange(len(torque)) * 1e-3
    nothing = np.zeros_like(torque)
    followed = Followed(
        t=t, q=nothing, torque=torque, warmth=nothing, sensed=np.zeros((len(torque), 0))
    )
    return as_logged(arm, followed, 1, np.random.default_rng(0)).torque


def test_logs_show_delay_filter_offset_and_constant() -> None:
    t = np.arange(3000) * 1e-3
    torque = np.column_stack([np.sin(9.0 * t), np.cos(7.0 * t)])
    late = logged_torque(case_with("delay", seconds=[2e-3, -1e-3]), torque)
    np.testing.assert_allclose(late[10:-10, 0], torque[8:-12, 0], atol=1e-12)
    np.testing.assert_allclose(late[10:-10, 1], torque[11:-9, 1], atol=1e-12)

    case = case_with("offset", shares=[0.1, 0.0])
    more = logged_torque(case, torque) - torque
    np.testing.assert_allclose(more[:, 0], 0.1 * case.arm.drives[0].coulomb)
    np.testing.assert_allclose(more[:, 1], 0.0, atol=1e-12)

    scaled = logged_torque(case_with("constant", shares=[0.05, -0.02]), torque)
    np.testing.assert_allclose(scaled, torque * [1.05, 0.98])

    # A first-order low-pass delays what is slow by 1 / (2 pi f).
    slow = logged_torque(case_with("filter", hertz=30.0, order=1), torque)
    delayed = np.sin(9.0 * (t - 1.0 / (2.0 * np.pi * 30.0)))
    np.testing.assert_allclose(slow[200:, 0], delayed[200:], atol=2e-2)


def test_friction_is_larger_on_the_way_up_and_smaller_when_warm() -> None:
    """What the controller has to push at a constant speed, against the truth of the
    study.
    """
    flat = case_with()
    speed, way = 0.3, {1.0: [], -1.0: []}
    for kind, sizes in (
        ("asymmetry", {"shares": [0.1, 0.0]}),
        ("warmth", {"per_kelvin": [-0.02, 0.0], "rise": [8.0, 8.0], "logged": True}),
    ):
        case = case_with(kind, **sizes)
        for side in way:
            t = np.arange(0.0, 1.5, 1e-3)
            motion = np.column_stack([side * speed * t, np.zeros_like(t)])
            some = follow(case, motion, start=200.0)
            none = follow(flat, motion, start=200.0)
            at = slice(1000, 1400)
            added = (some.torque - none.torque)[at, 0].mean()
            q, v = some.q[at, 0], np.full(400, side * speed)
            warmth = float(some.warmth[at, 0].mean())
            truth = true_friction(case, 0, q, v, warmth) - true_friction(
                flat, 0, q, v, warmth
            )
            assert abs(truth.mean()) > 0.0 or (kind == "asymmetry" and side < 0.0)
            assert added == pytest.approx(
                truth.mean(), abs=2e-3 * flat.arm.drives[0].coulomb
            )


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_bodies_behind_a_joint_that_is_left_out_are_added(
    joint: int, tmp_path: Path
) -> None:
    """Against Pinocchio, which locks the same joint of the same URDF."""
    case = case_with("left_out", n=3, joint=joint, moves=False, radians=0.7)
    write_robot(case, tmp_path)
    model = pin.buildModelFromXML((tmp_path / "arm.urdf").read_text())
    posture = pin.neutral(model)
    posture[joint] = 0.7
    reduced = pin.buildReducedModel(model, [joint + 1], posture)
    truth = true_standard(case)
    for k, inertia in enumerate(list(reduced.inertias)[1:], start=1):
        found = [truth[f"{name}_{k}"] for name in STANDARD]
        np.testing.assert_allclose(
            found, inertia.toDynamicParameters(), rtol=1e-9, atol=1e-9
        )
    assert f'name = "j{joint + 1}"' not in (tmp_path / "robot.toml").read_text()


@pytest.mark.parametrize("kind", list(TOLERANCES))
def test_declared_tolerances_are_read(kind: str, tmp_path: Path) -> None:
    arm = drawn_arm(np.random.default_rng(5), "drawn", 2, imus=False)
    sizes = KINDS[kind](arm, np.random.default_rng(1))
    items = (Imperfection(kind, sizes, declared=True),)
    write_robot(Case(label="test", seed=1, arm=arm, imperfections=items), tmp_path)
    text = (tmp_path / "robot.toml").read_text()
    assert text.count(TOLERANCES[kind].entry) == (2 if TOLERANCES[kind].of_joint else 1)
    assert load_robot(tmp_path / "robot.toml").joint_names == ("j1", "j2")


def test_what_files_state_of_drives() -> None:
    late = true_nuisances(case_with("delay", seconds=[2e-3, -1e-3]), 1)
    assert late.pop("delay") == -1e-3
    assert set(late.values()) == {0.0}
    slow = true_nuisances(case_with("filter", hertz=30.0, order=1), 0)
    assert slow["delay"] == pytest.approx(5.3e-3, rel=0.01)
    # f_+ = 1.1 and f_- = 1: the mean 1.05, and 0.05 of it to either side.
    uneven = true_nuisances(case_with("asymmetry", shares=[0.1, 0.0]), 0)
    assert uneven["asymmetry"] == pytest.approx(0.05 / 1.05)


def row_of(level: str, z: float, friction: float = 0.0) -> Row:
    p = {"name": "mx_1", "value": 1.0 + 0.1 * z, "std_error": 0.1, "truth": 1.0}
    joint = {"joint": "j1", "z": [friction] * 4, "z_without": [9.0] * 4}
    stage = {"level": level, "reasons": ["why"], "parameters": [p], "friction": [joint]}
    return {"failed": {}, "imperfections": [], "stages": {"friction": stage}}


def test_silent_wrongs_are_those_under_good() -> None:
    assert [x.name for x in silent_wrongs([row_of("good", 5.0)])] == ["mx_1"]
    assert [x.name for x in silent_wrongs([row_of("good", 1.0, friction=-6.0)])] == [
        "j1"
    ]
    assert not silent_wrongs(
        [row_of("usable", 50.0), row_of("poor", 9.0), row_of("good", 3.9)]
    )
    assert level_of(row_of("usable", 0.0)) == "usable"
    assert level_of(row_of("good", 0.0) | {"failed": {"gravity": "no"}}) == "poor"


def small(arm: Arm) -> Arm:
    return replace(arm, rate_hz=125.0, imus=(), temperatures=False)


def test_a_clean_arm_is_told_truly(tmp_path: Path) -> None:
    """The whole way of one small arm."""
    case = drawn(11, [CLEAN], alone=True)
    arm = small(drawn_arm(np.random.default_rng(8), "drawn", 1, imus=False))
    case = replace(case, arm=arm)
    row = scored(case, tmp_path)
    assert not row["failed"]
    stages = ["friction", "gravity", HANDED_ON, "inertia", "simultaneous"]
    assert list(row["stages"]) == stages
    assert not silent_wrongs([row])
    assert level_of(row) == "good"
    assert row["prediction"]["joints"]["j1"]["relative"] < 0.02
    assert "| clean | 1 | 1, 0, 0 |" in tables([row])
    # Another time its logs come from the cache.
    session = session_of(case, tmp_path / "logs")
    made = session.robot.stat().st_mtime_ns
    assert session_of(case, tmp_path / "logs").robot.stat().st_mtime_ns == made
    assert len(session.logs["friction"]) == 1
    assert all(path.is_file() for logs in session.logs.values() for path in logs)
