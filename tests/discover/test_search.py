"""The greedy search: what is added, what is taken back, and what either stance can see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover import greedy
from seqid_cli.discover.candidates import Candidate, Tried, best_of_each
from seqid_cli.discover.diagnose import wider_errors
from seqid_cli.discover.gates import Gates
from seqid_cli.discover.greedy import searched
from seqid_cli.discover.search import Search
from seqid_cli.discover.tellings import simplest
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Parameter, RigidStage, Stages
from seqid_cli.robot.base import free_basis
from tests.discover.arms import arm_scenes, at_joint, candidate, search_in

Array = NDArray[np.float64]

SOME = ("stribeck", "spring", "asymmetric_friction", "load_dependent_friction", "torque_bias")
DRAG = 0.3  # N m s^2/rad^2
HUMP, SPEED = 1.2, 0.3  # N m, rad/s
MASS = 0.8  # kg
RIPPLE, LOOP = 2.0, 80.0  # N m; rad/s, of the position loop


def effects(*names: str) -> list[Effect]:
    return [CATALOGUE[name] for name in names]


def stribeck(scene: Scene) -> Array:
    ratio = scene.motion.dq[:, 1] / SPEED
    return np.asarray(HUMP * np.exp(-(ratio**2)) * scene.sign[:, 1])


def drag(scene: Scene) -> Array:
    v = scene.motion.dq[:, 0]
    return np.asarray(DRAG * v * np.abs(v))


def both(scene: Scene) -> Array:
    return np.stack([drag(scene), stribeck(scene)], axis=1)


def payload(scene: Scene) -> Array:
    """A point mass at the last link's frame, some way out, in all logs."""
    X = CATALOGUE["payload"].columns(scene, None, {"from_log": 0.0})
    r = 0.3
    body = MASS * np.array([1.0, r, 0, 0, 0, 0, r**2, 0, 0, r**2])
    return np.stack([X[j] @ body for j in range(scene.robot.n)], axis=1)


def tried(search: Search, name: str, joint: int | None, **settings: float) -> Tried:
    return search.stage.try_all(search.system(), [candidate(name, joint, **settings)])[0]


def accepted(search: Search) -> list[tuple[str, int | None]]:
    return [t.candidate.key for t in search.accepted]


@pytest.fixture(scope="module")
def two() -> list[Scene]:
    return arm_scenes(both)


def test_two_effects_are_found_the_larger_first(two: list[Scene]) -> None:
    search = search_in(two)
    before = search.rms()
    rest = searched(search, effects(*SOME, "quadratic_drag"), Gates().passes, most=4)
    assert set(accepted(search)) == {("stribeck", 1), ("quadratic_drag", 0)}
    assert not any(Gates().passes(t) and not search.is_shape(t) for t in rest)
    fresh = search_in(two)
    ranked = fresh.ranked(effects("stribeck", "quadratic_drag"), fresh.system())
    assert ranked[0].candidate.key == search.accepted[0].candidate.key
    after = search.rms()
    assert np.all(after < 0.8 * before)
    np.testing.assert_allclose(after, search_in(arm_scenes()).rms(), rtol=0.1)


def test_their_parameters_come_out_beside_each_other(two: list[Scene]) -> None:
    search = search_in(two)
    searched(search, effects("stribeck", "quadratic_drag"), Gates().passes, most=4)
    found = {t.candidate.effect.name: search.marginal(t) for t in search.accepted}
    assert found["stribeck"].trial.coefficients[0] == pytest.approx(HUMP, rel=0.15)
    assert found["stribeck"].candidate.settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.2)
    drag = found["quadratic_drag"].trial.coefficients
    assert drag[0] == pytest.approx(DRAG, rel=0.15)


def test_no_more_effects_than_asked_for(two: list[Scene]) -> None:
    search = search_in(two)
    searched(search, effects("stribeck", "quadratic_drag"), Gates().passes, most=1)
    assert len(search.accepted) == 1


def test_a_stand_in_that_is_taken_back_does_not_come_for_ever(
    two: list[Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a slower effect stands in for is done with as well, when that one goes again."""
    search = search_in(two)
    begun = search.ranked(effects("stribeck"), search.system())[0]
    search.add(begun)
    bias = tried(search, "torque_bias", 0)
    calls: list[str] = []

    def stand_in(*of: object) -> Tried:
        calls.append("asked")
        assert len(calls) < 10
        return bias

    monkeypatch.setattr(greedy, "_steadier", stand_in)
    monkeypatch.setattr(
        Search, "prune", lambda self, gate: self.accepted.__delitem__(slice(1, None))
    )
    searched(search, effects("quadratic_drag"), Gates().passes, most=4)
    assert calls == ["asked"]
    assert len(search.accepted) == 1


def test_clean_logs_show_nothing() -> None:
    for seed in range(3):
        search = search_in(arm_scenes(seed=20 + seed))
        searched(search, effects(*SOME, "quadratic_drag", "rotor_inertia"), Gates().passes, most=4)
        assert accepted(search) == []


def test_the_residual_is_what_is_left_at_all_samples(two: list[Scene]) -> None:
    """At the rows it is the system's; torque of the accepted effects is what was put in."""
    search = search_in(two)
    for name, joint in (("stribeck", 1), ("quadratic_drag", 0)):
        settings = {"stribeck_speed": SPEED, "exponent": 2.0} if name == "stribeck" else {}
        search.add(tried(search, name, joint, **settings))
    search.timed = (False, False)
    system = search.system()
    left = search.residual(system)
    rows = search.stage.rows
    for j, expected in enumerate(system.residual()[: rows.n]):
        found = rows.torque(j, left)[:, j]
        assert np.sqrt(np.mean((found - expected) ** 2)) < 0.02 * np.std(expected)
    for scene, torque in zip(two, search.effect_torques(system), strict=True):
        slow = scene.motion.filtered(torque - both(scene), times=2)[scene.motion.usable]
        assert np.all(np.sqrt(np.mean(slow**2, axis=0)) < 0.3 * np.std(both(scene), axis=0))


def test_what_has_become_superfluous_is_taken_back(two: list[Scene]) -> None:
    """A hump fits a drag badly, but some; beside the drag itself it has nothing to do."""
    search = search_in(two)
    search.add(tried(search, "spring", 0, cubic=0.0))
    search.add(tried(search, "stribeck", 1, stribeck_speed=SPEED, exponent=2.0))
    search.add(tried(search, "quadratic_drag", 0))
    search.prune(Gates().passes)
    assert set(accepted(search)) == {("stribeck", 1), ("quadratic_drag", 0)}


def test_the_last_one_is_not_pruned(two: list[Scene]) -> None:
    search = search_in(two)
    search.add(tried(search, "spring", 0, cubic=0.0))
    search.prune(lambda _: False)
    assert accepted(search) == [("spring", 0)]


def test_an_effect_at_the_same_place_again_or_far_smaller_is_its_shape(two: list[Scene]) -> None:
    search = search_in(two)
    hump = tried(search, "stribeck", 1, stribeck_speed=SPEED, exponent=2.0)
    search.add(hump)
    other = tried(search, "stribeck", 1, stribeck_speed=2 * SPEED, exponent=1.0)
    assert search.is_shape(other)
    small = tried(search, "torque_bias", 1)
    share = float((search.bare[1] / search.noise[1]) ** 2)  # shares of what is left from the base's
    sizes = [replace(small, trial=replace(small.trial, relative=e * share)) for e in (0.03, 0.05)]
    assert [search.is_shape(t) for t in sizes] == [True, False]
    elsewhere = tried(search, "quadratic_drag", 0)
    assert not search.is_shape(elsewhere)


def test_another_line_is_not_the_first_ones_shape() -> None:
    def lines(scene: Scene) -> Array:
        t = scene.time
        return np.asarray(0.5 * np.sin(2 * np.pi * 50 * t) + 0.4 * np.sin(2 * np.pi * 31.3 * t))

    search = search_in(arm_scenes(at_joint(1, lines)))
    searched(search, effects("periodic_disturbance"), Gates().passes, most=4)
    assert accepted(search) == [("periodic_disturbance", 1)] * 2
    found = sorted(t.candidate.settings["frequency"] for t in search.accepted)
    np.testing.assert_allclose(found, [31.3, 50.0], atol=5e-3)


def test_the_best_setting_of_each(two: list[Scene]) -> None:
    search = search_in(two)
    speeds = (0.05, SPEED, 1.5)
    humps = [tried(search, "stribeck", 1, stribeck_speed=v, exponent=2.0) for v in speeds]
    bias = tried(search, "torque_bias", 0)
    best = best_of_each([bias, *humps])
    assert [t.candidate.key for t in best] == [("stribeck", 1), ("torque_bias", 0)]
    assert best[0] is humps[1]


def test_the_simpler_of_equals_leads(two: list[Scene]) -> None:
    search = search_in(two)
    rich = tried(search, "asymmetric_friction", 0)
    poor = tried(search, "torque_bias", 0)

    def gaining(t: Tried, share: float) -> Tried:
        return replace(t, trial=replace(t.trial, gain=share * np.ones(4)))

    assert rich.candidate.freedom == poor.candidate.freedom + 1
    assert simplest([gaining(rich, 1.0), gaining(poor, 0.99)]).candidate is poor.candidate
    assert simplest([gaining(rich, 1.0), gaining(poor, 0.97)]).candidate is rich.candidate


def test_a_change_without_a_cause_has_one_parameter_more() -> None:
    settings = {"warm_up_time": 60.0, "logged": 1.0, "reference_temperature": 20.0}
    thermal = Candidate(CATALOGUE["thermal_friction"], 0, settings)
    unknown = Candidate(CATALOGUE["friction_change"], 0, {})
    assert unknown.freedom == thermal.freedom + 1


def file_of(scene: Scene) -> Stages:
    """A parameter file whose rigid body is known to a part in a thousand."""
    basis = free_basis(scene.robot)
    parameters = [
        Parameter(name=name, value=0.0, std_error=1e-3, unit=basis.unit(k))
        for k, name in enumerate(basis.names)
    ]
    covariance = (1e-6 * np.eye(basis.size)).tolist()
    inertia = RigidStage(
        parameters=parameters, condition=1.0, rank=basis.size, covariance=covariance
    )
    return Stages(inertia=inertia)


def test_a_payload_of_all_logs_is_seen_by_who_keeps_the_file() -> None:
    """Put on after the file was identified: a free base swallows it."""
    scenes = arm_scenes(payload)
    stages = file_of(scenes[0])
    names = effects("payload", "base_tilt", "spring", "torque_constant", "stribeck")
    found = {}
    for kept in (True, False):
        search = search_in(scenes, stages, kept=kept)
        searched(search, names, Gates().passes, most=3)
        found[kept] = accepted(search)
        np.testing.assert_allclose(search.rms()[1], search_in(arm_scenes()).rms()[1], rtol=0.3)
    assert ("payload", None) in found[True]
    assert found[False] == []


def test_the_kept_base_moves_within_the_files_errors_only() -> None:
    scenes = arm_scenes(payload)
    stages = file_of(scenes[0])
    free, kept = (search_in(scenes, stages, kept=k) for k in (False, True))
    at = list(free.base.basis.names).index("mx_1")
    moved = [abs(float(s.system().theta[at])) for s in (free, kept)]
    assert moved[0] == pytest.approx(0.3 * MASS, rel=0.02)  # m l of what hangs on the first link
    assert moved[1] < 0.6 * moved[0]
    assert np.all(kept.rms() >= free.rms())
    assert kept.rms().max() > 3 * free.rms().max()


def test_an_ordinary_time_offset_belongs_to_the_base() -> None:
    """Half a sample is every drive's; five samples are an effect and not absorbed."""

    def late(share: float) -> Search:
        def extra(scene: Scene) -> Array:
            slope = np.gradient(scene.modelled, 1.0 / scene.motion.rate_hz, axis=0)
            return np.asarray(-share / scene.motion.rate_hz * slope)

        return search_in(arm_scenes(extra))

    assert late(0.5).timed == (True, True)
    assert late(5.0).timed == (False, False)


def test_the_time_offset_is_taken_out_where_a_timing_effect_is_accepted() -> None:
    search = search_in(arm_scenes())
    assert search.timed == (True, True)
    search.add(tried(search, "actuator_lag", 0))
    assert search.timed == (False, True)


@pytest.mark.parametrize("drive", [0, 1])
def test_a_coupled_pair_is_named_at_the_joint_that_it_explains_most(drive: int) -> None:
    """Whichever joint's drive it is: the second joint is the quieter one."""

    def coupled(scene: Scene) -> Array:
        settings = {"neighbour": 1.0 - 2.0 * drive, "ratio": 1.0}
        X = CATALOGUE["transmission_coupling"].columns(scene, drive, settings)
        c = np.array([1.5, 0.3, 0.02])
        return np.stack([X[j] @ c for j in (0, 1)], axis=1)

    search = search_in(arm_scenes(coupled))
    searched(search, effects("transmission_coupling"), Gates().passes, most=2)
    assert accepted(search) == [("transmission_coupling", 1)]
    assert search.accepted[0].candidate.settings["ratio"] == 1.0


def shaken(scene: Scene) -> Array:
    """A ripple of the second drive whose fast waves move the arm instead of the drive's current."""
    gear, v = scene.gear[1], scene.motion.dq[:, 1]
    wave = RIPPLE * np.exp(1j * gear * scene.motion.q[:, 1])
    answered = wave / (1.0 + (gear * v / LOOP) ** 4)
    return np.stack([np.zeros(scene.samples), answered.imag], axis=1)


def test_a_ripple_is_told_where_the_drive_holds_against_it() -> None:
    search = search_in(arm_scenes(shaken))
    searched(search, effects("torque_ripple"), Gates().passes, most=3)
    assert accepted(search) == [("torque_ripple", 1)]
    found = search.accepted[0]
    assert found.candidate.settings == {"order": 1.0, "law": 0.0, "lag": 0.0}
    amplitude = float(np.hypot(*found.trial.coefficients))
    assert amplitude == pytest.approx(RIPPLE, rel=0.05)


def test_noise_that_lasts_makes_coefficients_less_certain() -> None:
    """Rows are five per period of the cut-off and hold two: white noise alone gives the root."""

    def lasting(scene: Scene) -> Array:
        rng = np.random.default_rng(scene.log)
        slow = np.convolve(rng.normal(size=scene.samples + 239), np.ones(240) / 12.0, "valid")
        return np.asarray(stribeck(scene) + 0.1 * slow)

    wider = {}
    for name, torque in (("white", stribeck), ("lasting", lasting)):
        search = search_in(arm_scenes(at_joint(1, torque)))
        search.add(search.ranked(effects("stribeck"), search.system())[0])
        (found,) = wider_errors(search)
        wider[name] = float(found[0])
    assert 1.2 < wider["white"] < 2.0
    assert wider["lasting"] > 1.5 * wider["white"]


def test_a_middling_gain_is_chance_where_noise_may_be_coloured(
    two: list[Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Little above the noise floor it is white, if logs are long enough to tell."""
    monkeypatch.setattr("seqid_cli.discover.search.chance", lambda *_, **__: 1.0)
    search = search_in(two)
    system = search.system()
    hump = tried(search, "stribeck", 1, stribeck_speed=SPEED, exponent=2.0)
    search.add(hump)
    noise = search.noise[:2]

    def holds(gain: float, floor: Array) -> bool:
        return search.holds(replace(hump, trial=replace(hump.trial, relative=gain)), system, floor)

    assert not holds(0.3, noise)  # of less than a minute
    monkeypatch.setattr("seqid_cli.discover.search.ENOUGH_S", 5.0)
    assert holds(0.3, noise)
    assert not holds(0.3, 0.5 * noise)
    assert not holds(0.1, noise)
    assert holds(0.9, 0.5 * noise)


def test_what_is_as_slow_as_an_offset_must_hold_as_offsets_do() -> None:
    """An offset that only some logs have gives an asymmetry of friction in white noise as well."""

    def asymmetry(lasting: float) -> tuple[Search, Tried]:
        def torque(scene: Scene) -> Array:
            return np.full(scene.samples, 0.4 if scene.log == 0 else lasting)

        search = search_in(arm_scenes(at_joint(1, torque), logs=8, seconds=12.0))
        return search, tried(search, "asymmetric_friction", 1)

    for lasting, holds in ((0.4, True), (0.0, False)):
        search, found = asymmetry(lasting)
        middling = replace(found, trial=replace(found.trial, relative=0.3))
        assert search.holds(middling, search.system(), search.noise[:2]) == holds


def test_what_shows_above_the_cut_off_needs_no_holding() -> None:
    """Its rows are other ones than the stretches of time are made of."""

    def hum(scene: Scene) -> Array:
        return np.asarray(np.sin(2.0 * np.pi * 60.0 * scene.time))

    search = search_in(arm_scenes(at_joint(1, hum)))
    found = tried(search, "periodic_disturbance", 1, frequency=60.0, clocks=1.0)
    assert max(found.columns) >= search.stage.rows.n
    assert search.holds(found, search.system(), search.noise[:2])


LATE_S = 0.02


def lagging(scene: Scene) -> Array:
    """What the command of first-order drives is ahead of their torque."""
    return np.asarray(LATE_S * scene.motion.rate_hz * np.gradient(scene.modelled, axis=0))


def stamped_late(scene: Scene) -> Array:
    at = np.arange(scene.samples) - LATE_S * scene.motion.rate_hz
    late = [np.interp(at, np.arange(scene.samples), tau) for tau in scene.modelled.T]
    return np.asarray(np.stack(late, axis=1) - scene.modelled)


@pytest.mark.parametrize(
    ("extra", "name", "value"),
    [(lagging, "actuator_lag", LATE_S), (stamped_late, "time_skew", LATE_S)],
)
def test_one_lag_of_all_drives_is_no_skew_of_the_log(
    extra: Callable[[Scene], Array], name: str, value: float
) -> None:
    search = search_in(arm_scenes(extra, noise=(0.03, 0.01)))
    searched(search, effects("actuator_lag", "time_skew"), Gates().passes, most=1)
    assert accepted(search) == [(name, None)]
    assert search.accepted[0].trial.coefficients[0] == pytest.approx(value, rel=0.1)
