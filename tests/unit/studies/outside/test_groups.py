"""Every group draws what it says, and asks of an answer what its question is."""

from typing import Any

import mujoco
import numpy as np
import pytest

from seqid_cli.effects.repetition import period_in_samples
from tests.studies.outside.changes import CHANGES
from tests.studies.outside.effects import belt
from tests.studies.outside.foreign import FOREIGN
from tests.studies.outside.groups import CATALOGUE, GROUPS
from tests.studies.outside.plan import Case, drawn
from tests.studies.outside.questions import answers_to
from tests.studies.outside.robotfiles import robot_toml
from tests.studies.outside.score import overlooked
from tests.studies.outside.simulate import built, simulate
from tests.studies.outside.tabulate import tables
from tests.unit.studies.outside.bench import quiet_arm
from tests.unit.studies.outside.test_judge import answer, finding

PUSH = ["log_05.parquet", 4.0, 8.0]


@pytest.mark.parametrize("group", GROUPS)
def test_a_seed_is_one_case_of_each_group(group: str) -> None:
    first, again = (GROUPS[group](3) for _ in range(2))
    assert first.outline == again.outline
    assert first.arm.drives == again.arm.drives
    assert first.shares == again.shares
    assert first.group == group
    if group != "mixed":
        assert first.arm.drives != drawn(3).arm.drives


def test_clean_arms_have_files_of_the_stages_and_of_one_step() -> None:
    cases = [GROUPS["clean"](seed) for seed in range(30)]
    assert not any(case.effects for case in cases)
    assert {case.outline.flow for case in cases} == {"late", "step_late", "single"}


def test_singles_and_foreign_laws_come_in_turn() -> None:
    first = [GROUPS["singles"](seed) for seed in range(3)]
    assert [case.outline.kinds[0] for case in first] == [*CATALOGUE][:3]
    assert len(FOREIGN) >= 6
    laws = [GROUPS["foreign"](seed) for seed in range(4)]
    assert [case.outline.kinds[0] for case in laws] == [*FOREIGN][:4]
    assert min(case.arm.n for case in laws) >= 2  # most look at another joint


def pushed_case(*, longest_s: float) -> Case:
    cases = (GROUPS["pushes"](seed) for seed in range(40))
    return next(
        case
        for case in cases
        if max(push.end - push.start for push in case.pushes) < longest_s
    )


def test_pushes_last_from_a_fifth_of_a_second_to_twenty() -> None:
    cases = [GROUPS["pushes"](seed) for seed in range(12)]
    lengths = [push.end - push.start for case in cases for push in case.pushes]
    assert 0.2 <= min(lengths) < 1.0
    assert 10.0 < max(lengths) <= 20.0
    for case in cases:
        for push in case.pushes:
            log = case.asked[push.log]
            assert log.effects
            assert 1.0 < push.start < push.end < len(log.motion) * 1e-3 - 0.5
    # In some cases both logs, in most one.
    assert 0.5 < np.mean([len(case.pushes) == 1 for case in cases]) < 1.0


def test_a_push_changes_the_torque_while_it_lasts() -> None:
    case = pushed_case(longest_s=3.0)
    (push, *_) = case.pushes
    log = case.asked[push.log]
    plain, pushed = (
        simulate(case.arm, log.motion, 1, effects) for effects in ((), log.effects)
    )
    apart = np.abs(pushed.true_torque - plain.true_torque) / np.std(
        plain.true_torque, axis=0
    )
    within = (plain.t >= push.start) & (plain.t <= push.end)
    assert apart[plain.t < push.start].max() < 1e-9
    assert apart[within].max() > 0.05
    assert np.median(apart[plain.t > push.end + 0.5]) < 1e-3


def test_changes_come_before_the_logs_or_between_them() -> None:
    cases = [GROUPS["changes"](seed) for seed in range(2 * len(CHANGES))]
    of_first = [bool(case.asked[0].effects) for case in cases]
    assert sum(of_first) == len(CHANGES)
    assert all(case.asked[1].effects for case in cases)
    assert not any(case.before for case in cases)
    names = {case.effects[0].name for case in cases}
    assert names == {"friction_change", "torque_constant", "joint_zero", "payload"}


def test_an_arm_on_a_belt_rings_at_eight_to_twenty_hertz() -> None:
    """With the motor held, by the period of a free swing of the link."""
    arm = quiet_arm(3)
    for seed in range(3):
        effect = belt(arm, 1, np.random.default_rng(seed))
        model = built(arm, [effect])
        model.opt.gravity[:] = 0.0
        data = mujoco.MjData(model)
        link = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "j2")
        held = [k for k in range(model.nv) if k != link]
        model.dof_armature[held] = 1e6
        model.dof_frictionloss[:] = 0.0
        data.qpos[link] = 1e-3
        swing = []
        for _ in range(1000):
            mujoco.mj_step(model, data)
            swing.append(data.qpos[link])
        crossings = np.flatnonzero(np.diff(np.sign(swing)))
        hertz = 500.0 * (len(crossings) - 1) / np.ptp(crossings)
        assert 6.0 < hertz < 25.0


def test_belts_have_imus_and_arms_of_seven_no_rotors_in_their_files() -> None:
    for seed in range(4):
        belts, whole = GROUPS["belts"](seed), GROUPS["seven"](seed)
        assert belts.arm.imus
        assert belts.effects[0].name == "joint_elasticity"
        assert whole.arm.n == 7
        assert "rotor_inertia" not in robot_toml(whole.arm)


def test_walks_go_beyond_the_friction_trials() -> None:
    for seed in range(4):
        case = GROUPS["walks"](seed)
        links = case.arm.links[: case.arm.n]
        for log in case.asked:
            speed = np.abs(np.gradient(log.motion, 1e-3, axis=0))
            way = np.abs(log.motion - [link.middle for link in links])
            beyond = (speed > [0.8 * link.speed for link in links]) | (
                way > [link.reach for link in links]
            )
            assert 0.05 < beyond.any(axis=1).mean() < 0.9
            assert np.all(speed < [1.5 * link.speed for link in links])


def test_periodic_excitation_repeats() -> None:
    """All joints have one period of 4 to 8 s, and go through it several times."""
    for seed in range(3):
        for log in GROUPS["periodic"](seed).asked:
            periods = [period_in_samples(q[::10]) / 100.0 for q in log.motion.T]
            assert np.ptp(periods) < 0.05
            assert 3.9 < periods[0] < 8.1
            assert len(log.motion) * 1e-3 > 3.5 * periods[0]


def row_of(group: str, **changed: Any) -> dict[str, Any]:
    more = {"group": group, "variant": "", "verdict": "effect_found", "causes": []}
    return answer(**{**more, **changed})


@pytest.mark.parametrize(
    ("events", "exact", "told", "alone"),
    [
        ([["/x/log_05.parquet", 4.2, 8.5, ["j2"]]], True, True, True),
        ([["/x/log_05.parquet", 5.0, 8.0, ["j2"]]], False, True, True),
        ([["/x/log_06.parquet", 4.0, 8.0, ["j2"]]], False, False, False),
        (
            [["/x/log_05.parquet", 4.0, 8.0, ["j2"]], ["/x/log_05.parquet", 1, 2, []]],
            True,
            True,
            False,
        ),
        ([], False, False, True),
    ],
)
def test_a_push_is_told_with_its_start_and_its_end(
    events: list[Any], exact: bool, told: bool, alone: bool
) -> None:
    hidden = {"kinds": ["external_contact"], "joints": [""], "pushes": [PUSH]}
    row = row_of(
        "pushes", events=events, findings=[finding("external_contact", "")], **hidden
    )
    assert [*answers_to(row).values()] == [exact, told, alone]
    # Without the finding nobody is told.
    assert not any([*answers_to(row | {"findings": []}).values()][:2])


def test_a_change_may_be_among_the_causes() -> None:
    change = {"kinds": ["joint_zero"], "joints": ["j2"], "verdict": "values_changed"}
    row = row_of("changes", causes=[["j1", "joint_zero", "j2", 0.6]], **change)
    assert all(answers_to(row).values())
    other = row_of("changes", causes=[["j2", "joint_zero", "j1", 0.6]], **change)
    assert not any(answers_to(other).values())


def test_a_foreign_law_is_unexplained_or_not_named() -> None:
    hidden = {"kinds": ["product_of_speeds"], "joints": ["j2"]}
    right = row_of(
        "foreign",
        verdict="unexplained",
        unexplained=[["j2", ["velocity", "other_joint:j1"]]],
        **hidden,
    )
    assert [*answers_to(right).values()] == [True, True]
    other = right | {"unexplained": [["j2", ["time"]]]}
    assert [*answers_to(other).values()] == [False, True]
    named = other | {"findings": [finding("stribeck")], "verdict": "effect_found"}
    assert [*answers_to(named).values()] == [False, False]


def test_nothing_missing_beside_many_floors_is_counted() -> None:
    row = row_of("changes", verdict="nothing_missing")
    assert overlooked(row)
    assert not overlooked(row | {"residuals": {"j2": [0.2, 0.1, 0.2]}})
    assert not overlooked(row | {"verdict": "too_short"})
    row |= {"kinds": ["joint_zero"], "diagnose_seconds": 2.0, "seconds": 9.0}
    text = tables([row], "changes")
    assert (
        "| `nothing_missing` beside more than 2.5 noise floors | 1 | 1 | 100 % |"
        in text
    )
    assert "Diagnosing takes 2.0 CPU s (median), 2.0 at most" in text
