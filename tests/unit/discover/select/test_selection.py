"""What the selection takes, what it leaves, and which name it gives."""

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import FileResidual, Investigation
from seqid_cli.discover.noise.floor import NoiseFloor
from seqid_cli.discover.select import selection, terms
from seqid_cli.discover.select.model import FREE, HELD, Model
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import (
    ScoredTerm,
    SelectionResult,
    TermResult,
)
from seqid_cli.discover.select.rows import Score
from seqid_cli.discover.select.selection import Selection
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.settings import DiscoverSettings, EvidenceSettings
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene, travel
from tests import Array
from tests.unit.discover.arms import (
    DRAG,
    NOISE,
    Extra,
    arm_scenes,
    at_joint,
    candidate,
    drag,
    file_of,
    ground_of,
    model_of,
    payload,
    selected,
    stribeck,
)

SOME = (
    "stribeck",
    "spring",
    "quadratic_drag",
    "torque_bias",
    "load_dependent_friction",
)
SPEED = 0.3  # rad/s, of the hump
WAVE, LOOP = 2.0, 80.0  # N m; rad/s, of the position loop
LATE_S = 0.02
STOP = 6.0  # N m/rad^2
LOSS = 0.05  # N m of friction per N m of load


def waves(scene: Scene) -> Array:
    """No effect of the catalogue: a brake that drags at some positions."""
    return 0.5 * np.cos(4.0 * scene.motion.q[:, 0]) * scene.motion.dq[:, 0] ** 2


def keys(found: SelectionResult) -> list[tuple[str, int | None]]:
    return [one.term.key for one in found.terms]


@pytest.fixture(scope="module")
def pair() -> SelectionResult:
    return selected(
        arm_scenes(lambda s: at_joint(0, drag)(s) + stribeck(SPEED)(s)), SOME
    )


def test_nothing_is_taken_where_the_model_is_right() -> None:
    assert keys(selected(arm_scenes(), SOME)) == []


def test_both_effects_are_taken_with_their_settings_and_sizes(
    pair: SelectionResult,
) -> None:
    assert sorted(keys(pair), key=str) == [("quadratic_drag", 0), ("stribeck", 1)]
    found = {one.term.name: one.term for one in pair.terms}
    settings = found["stribeck"].what.settings
    assert settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.1)
    model, drag = pair.model, found["quadratic_drag"]
    error = np.sqrt(model.covariance(drag)[0, 0])
    assert abs(model.coefficients(drag)[0] - DRAG) < 4.0 * error < 0.1 * DRAG


def test_what_is_told_keeps_candidates_of_its_own_joints_alone() -> None:
    found = selected(arm_scenes(at_joint(0, drag)), ("quadratic_drag", "spring"))
    assert keys(found) == [("quadratic_drag", 0)]
    ground = found.model.ground
    assert {address[1] for address in ground.stage._computed} <= {0, None}
    assert {joint for joint, _ in ground._smooth} <= {0}


def test_fits_without_each_block_are_let_go_of_once_all_is_told(
    pair: SelectionResult,
) -> None:
    linear = pair.model.linear
    before = linear.jackknife(slice(0, 2))
    assert "_without_part" in vars(linear)
    investigation = Investigation(
        logs=(),
        selection=pair,
        floor=cast(NoiseFloor, None),
        events=(),
        file_residual=cast(FileResidual, None),
        settings=DiscoverSettings(),
    )
    investigation.forget_search()
    assert "_without_part" not in vars(linear)
    np.testing.assert_array_equal(linear.jackknife(slice(0, 2)), before)


def test_what_no_effect_explains_is_a_smooth_function() -> None:
    found = selected(arm_scenes(at_joint(0, waves)), SOME)
    one = found.terms[0]
    assert (one.term.smooth, one.term.joint) == (True, 0)
    with_it, without = found.model.linear.left_out[0], one.left_without[0]
    assert (
        Options().improvement
        < one.share
        <= 1.0 - np.sum(with_it**2) / np.sum(without**2) + 1e-9
    )


def test_the_evidence_that_is_asked_for_is_a_setting() -> None:
    scenes = arm_scenes(at_joint(0, drag))
    low = Options.of(EvidenceSettings(min_log_evidence=3.0))
    assert keys(selected(scenes, SOME, low)) == [("quadratic_drag", 0)]
    assert keys(selected(scenes, SOME, replace(low, min_log_bayes_factor=1e9))) == []


def gain_and_losses(scene: Scene) -> Array:
    """A motor that tells a third too much, and losses of a sixteenth of that."""
    lost = 0.02 * np.abs(scene.load[:, 0]) * scene.sign[:, 0]
    return np.asarray(0.3 * scene.modelled[:, 0] + lost)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exact", "moves_apart", "options", "told"),
    [
        (False, False, Options(negligible_share=0.0), 2),
        (False, False, Options(negligible_share=0.04), 1),
        (True, False, Options(negligible_share=0.04), 2),
        (False, True, Options(negligible_share=0.0, apart=0.0), 2),
        (False, True, Options(negligible_share=0.0, apart=0.2), 1),
    ],
)
def test_the_lesser_of_two_that_look_alike_may_be_the_error_of_the_other(
    exact: bool, moves_apart: bool, options: Options, told: int
) -> None:
    """One that is exact has no error; where motor and link move apart it has more."""
    gain = type(CATALOGUE["torque_constant"])()
    gain.exact = exact
    gain.apart = moves_apart
    scenes = arm_scenes(at_joint(0, gain_and_losses))
    found = selected(scenes, [gain, "load_dependent_friction"], options)
    assert (
        keys(found) == [("torque_constant", 0), ("load_dependent_friction", 0)][:told]
    )
    assert moves_apart or len(found.model.terms) == 2  # for the other one's sake


def test_a_payload_of_all_logs_is_seen_where_the_file_was_before_it() -> None:
    """Blocks of time do not miss it where the base is free to leave the file."""
    scenes = arm_scenes(payload)
    stages = file_of(scenes[0])
    names = ("payload", "base_tilt", "spring", "torque_constant", "stribeck")
    found = selected(scenes, names, stages=stages)
    assert ("payload", None) in keys(found)
    assert found.model.hold == HELD
    model = model_of(scenes, FREE, stages)
    model.add([candidate("payload", None, from_log=0.0)])
    (term,) = model.terms
    told = model.beside(term).scores([term.part])[0]
    assert told.file_gain > 10.0 * max(float(told.part_gains.sum()), 1.0)


@pytest.mark.slow
def test_minus_a_body_is_no_payload() -> None:
    """Whatever else it is: the arm would have to lose mass that it may not have."""
    scenes = arm_scenes(lambda scene: -payload(scene))
    found = selected(scenes, ("payload",), stages=file_of(scenes[0]))
    assert ("payload", None) not in keys(found)


def bent_spring(scene: Scene) -> Array:
    """A rubber stop: no spring of the catalogue bends so."""
    bent = np.maximum(scene.motion.q[:, 1] - 0.2, 0.0)
    return -STOP * bent**2


@pytest.mark.parametrize(("cycles", "share"), [(2.0, 0.2), (20.0, 0.04)])
def test_a_few_waves_beside_a_spring_may_be_the_error_of_its_law(
    cycles: float, share: float
) -> None:
    """`cycles` are over the joint's travel; finer waves are a law of their own."""
    scenes = arm_scenes(at_joint(1, bent_spring), logs=2, seconds=8.0)
    turns = scenes[0].gear[1] * travel(scenes, 1) / (2.0 * np.pi)
    spring = candidate("spring", 1, cubic=1.0)
    ripple = candidate("torque_ripple", 1, order=cycles / turns, law=0.0, lag=0.0)
    model = Model(ground_of(scenes), FREE, [spring, ripple])
    of_spring, of_ripple = model.terms
    chosen = Selection(model, list(CATALOGUE.values()))
    found = chosen._error_of_law(of_spring, of_ripple)
    assert found == pytest.approx(share)


def test_an_offset_hides_no_drift() -> None:
    """An offset since the second log is exact: what creeps beside it is no error."""
    scenes = arm_scenes(logs=2, seconds=8.0)
    offset = candidate("torque_bias", 1, from_log=1.0)
    drift = candidate("drift", 1, duration=8.0)
    model = Model(ground_of(scenes), FREE, [offset, drift])
    chosen = Selection(model, list(CATALOGUE.values()))
    assert chosen._error_of_law(*model.terms) == 0.0


@pytest.mark.slow
def test_a_fine_ripple_beside_a_spring_is_told() -> None:
    def both(scene: Scene) -> Array:
        wave = np.sin(scene.gear[1] * scene.motion.q[:, 1])
        return bent_spring(scene) + 0.1 * STOP * wave

    found = selected(arm_scenes(at_joint(1, both)), ["spring", "torque_ripple"])
    assert {("spring", 1), ("torque_ripple", 1)} <= set(keys(found))


COUPLED = np.array([1.5, 0.3, 0.02])  # N m, N m s/rad, kg m^2


def coupling(drive: int) -> Extra:
    """Torque of a drive of one joint that turns with the other one as well."""

    def coupled(scene: Scene) -> Array:
        settings = {"neighbour": 1.0 - 2.0 * drive, "ratio": 1.0}
        X = CATALOGUE["transmission_coupling"].columns(scene, drive, settings)
        return np.stack([X[j] @ COUPLED for j in (0, 1)], axis=1)

    return coupled


@pytest.mark.slow
def test_a_coupled_pair_is_named_where_the_file_tells_whose_friction_it_is() -> None:
    """It makes far more torque beside the noise at the other joint."""
    scenes = arm_scenes(coupling(0))
    file = file_of(scenes[0])
    effects = ["transmission_coupling", "friction_change"]
    (taken,) = selected(scenes, effects, stages=file).terms
    assert taken.term.key == ("transmission_coupling", 0)
    coefficients = taken.model.coefficients(taken.term)
    np.testing.assert_allclose(coefficients, COUPLED, rtol=0.1, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("drive", [0, 1])
def test_a_coupled_pair_is_named_once(drive: int) -> None:
    """Whichever joint's drive it is: the two have the same columns."""
    coupled = coupling(drive)
    scenes = arm_scenes(coupled)
    (taken,) = selected(scenes, ["transmission_coupling"]).terms
    assert taken.term.name == "transmission_coupling"
    torque = np.concatenate([coupled(scene) for scene in scenes])
    in_noise = np.sqrt(np.mean(torque**2, axis=0)) / NOISE
    assert taken.term.joint == np.argmax(in_noise)
    assert taken.term.what.settings["ratio"] == 1.0


def shaken(scene: Scene) -> Array:
    """A ripple of the second drive whose fast waves move the arm instead of the drive's
    current.
    """
    wave = WAVE * np.sin(scene.gear[1] * scene.motion.q[:, 1])
    return wave / (1.0 + (scene.gear[1] * scene.motion.dq[:, 1] / LOOP) ** 4)


@pytest.mark.slow
def test_a_ripple_is_told_where_the_drive_holds_against_it() -> None:
    found = selected(arm_scenes(at_joint(1, shaken)), ["torque_ripple"])
    assert keys(found)[0] == ("torque_ripple", 1)
    term = found.terms[0].term
    assert term.what.settings == {"order": 1.0, "law": 0.0, "lag": 0.0}
    amplitude = np.hypot(*found.model.coefficients(term))
    # above the cut-off the arm gives way
    assert amplitude == pytest.approx(WAVE, rel=0.05)


def lagging(scene: Scene) -> Array:
    return np.asarray(
        LATE_S * scene.motion.rate_hz * np.gradient(scene.modelled, axis=0)
    )


def stamped_late(scene: Scene) -> Array:
    n = np.arange(scene.samples)
    late = [
        np.interp(n - LATE_S * scene.motion.rate_hz, n, tau) for tau in scene.modelled.T
    ]
    return np.asarray(np.stack(late, axis=1) - scene.modelled)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extra", "name"), [(lagging, "actuator_lag"), (stamped_late, "time_skew")]
)
def test_one_lag_of_all_drives_is_no_skew_of_the_log(extra: Extra, name: str) -> None:
    scenes = arm_scenes(extra, noise=(0.03, 0.01))
    found = selected(scenes, ["actuator_lag", "time_skew"])
    term = found.terms[0].term
    assert term.key == (name, None)
    assert found.model.coefficients(term)[0] == pytest.approx(LATE_S, rel=0.1)


def with_terms(
    extra: Extra, smooth: str, *effects: Candidate
) -> tuple[Model, list[Term]]:
    """Return a model that has the first effect and a smooth function, and the effects
    as terms.
    """
    ground = ground_of(arm_scenes(extra))
    known = terms.effects(ground.stage, effects, ground.size)
    model = Model(ground, HELD)
    model.terms = [
        known[0],
        next(t for t in ground.smooth_terms(1) if t.name == smooth),
    ]
    model.settle()
    return model, known


def test_one_effect_goes_before_two_that_explain_as_much() -> None:
    drift, bias = candidate("drift", 1, duration=100.0), candidate("torque_bias", 1)
    extra = at_joint(1, lambda scene: 0.8 + 0.01 * scene.time)  # an offset that drifts
    model, (of_two, one) = with_terms(extra, "time of all logs", bias, drift)
    found, before = Selection(model, []), list(model.terms)
    found.merged()
    assert model.terms == before
    found.tied = {of_two.key: [one]}
    found.merged()
    assert [term.name for term in model.terms] == ["drift"]


def bent(scene: Scene) -> Array:
    """Losses of the second gear that grow less and less with the load."""
    load = np.abs(scene.load[:, 1])
    return np.asarray(LOSS * load * (1.0 - 0.004 * load) * scene.sign[:, 1])


def stepped(scene: Scene) -> Array:
    """Losses that begin at some load."""
    return np.where(np.abs(scene.load[:, 1]) > 60.0, 6.0, 0.0) * scene.sign[:, 1]


@pytest.mark.parametrize(
    ("law", "told"), [(bent, "load_dependent_friction"), (stepped, "load x direction")]
)
def test_a_function_does_not_hide_the_effect_whose_law_it_mends(
    law: Callable[[Scene], Array], told: str
) -> None:
    loss = candidate("load_dependent_friction", 1)
    model, _ = with_terms(at_joint(1, law), "load x direction", loss)
    assert keys(Selection(model, []).told(0.0)) == [(told, 1)]


LAGS = {"even": 60.0, "behind": 300.0}  # nats of 10,000: as likely, and as good
SIMPLE = "torque_bias"  # one parameter
RICH = "position_dependent_friction"
CHANGED = "friction_change"


@pytest.mark.parametrize(
    ("lags", "head"),
    [
        ({RICH: 0.0, SIMPLE: LAGS["even"]}, SIMPLE),
        ({RICH: 0.0, SIMPLE: LAGS["behind"]}, RICH),
        ({RICH: 0.0, CHANGED: LAGS["even"], "stribeck": LAGS["even"]}, CHANGED),
        ({RICH: 0.0, CHANGED: LAGS["behind"], "stribeck": 0.0}, "stribeck"),
    ],
)
def test_the_most_probable_name_heads_or_one_that_is_tied_with_it(
    monkeypatch: pytest.MonkeyPatch, lags: dict[str, float], head: str
) -> None:
    """Of tied names a change that logs show, else the one with fewest parameters."""
    monkeypatch.setattr(selection, "has_trials", lambda *_: True)
    model = model_of(arm_scenes(logs=1, seconds=8.0))
    rivals = [rival(model, name, 1e4 - lag) for name, lag in lags.items()]
    result = TermResult(
        scored=rivals[-1],
        rivals=tuple(rivals),
        left_without=(),
        evidence=1e4,
        share=0.9,
        model=model,
        alternatives={},
        log_evidence_of_variation=0.0,
    )
    assert Selection(model, ())._heading(result, set()).name == head


def rival(model: Model, name: str, gain: float) -> ScoredTerm:
    """Return an effect of the first joint that gains as much in every block."""
    effect = CATALOGUE[name]
    stage = model.ground.stage
    of_grid = next(effect.grid(stage.scenes, 0, model.left()))
    (term,) = terms.effects(stage, [Candidate(effect, 0, of_grid)], model.ground.size)
    blocks = model.ground.rows.blocks
    score = Score(part_gains=np.full(blocks, gain / blocks), rows=np.ones(blocks))
    (fit,) = model.linear.fits([term.part])
    fit = replace(fit, log_bayes_factor=gain)
    return ScoredTerm(term=term, fit=fit, score=score)


def test_a_larger_function_gives_way_to_an_effect_that_is_told_beside_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A hump was told at too low a speed, beside the rest of the same hump."""
    monkeypatch.setattr(Selection, "is_told", lambda *_: True)
    scenes = arm_scenes(stribeck(0.2), logs=2, noise=(0.05, 0.005))
    model = model_of(scenes, HELD)
    ground = model.ground
    hump = candidate("stribeck", 1, stribeck_speed=0.1, exponent=2.0)
    function = next(
        term
        for term in ground.smooth_terms(1)
        if term.what.quantities == ("velocity", "direction")
    )
    model.terms = [*terms.effects(ground.stage, [hump], ground.size), function]
    model.settle()
    (told,) = Selection(model, [CATALOGUE["stribeck"]]).told().terms
    assert told.term.name == "stribeck"
    speed = told.term.what.settings["stribeck_speed"]
    assert speed == pytest.approx(0.2, rel=0.03)
