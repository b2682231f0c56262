"""What the selection takes, what it leaves, and which name it gives."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.select import terms
from seqid_cli.discover.select.model import FREE, HELD, Model
from seqid_cli.discover.select.naming import named
from seqid_cli.discover.select.results import Options, Selected
from seqid_cli.discover.select.selection import Selection, select
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from tests import Array
from tests.unit.discover.arms import (
    DRAG,
    Extra,
    arm_scenes,
    at_joint,
    drag,
    file_of,
    ground_of,
    payload,
)

SOME = ("stribeck", "spring", "quadratic_drag", "torque_bias", "load_dependent_friction")
HUMP, SPEED = 1.2, 0.3  # N m, rad/s
RIPPLE = 0.5  # N m
WAVE, LOOP = 2.0, 80.0  # N m; rad/s, of the position loop
LATE_S = 0.02
LOSS = 0.05  # N m of friction per N m of load


def stribeck(scene: Scene) -> Array:
    ratio = scene.motion.dq[:, 1] / SPEED
    return np.asarray(HUMP * np.exp(-(ratio**2)) * scene.sign[:, 1])


def both(scene: Scene) -> Array:
    return np.stack([drag(scene), stribeck(scene)], axis=1)


def waves(scene: Scene) -> Array:
    """No effect of the catalogue: a brake that drags at some positions."""
    return np.asarray(RIPPLE * np.cos(4.0 * scene.motion.q[:, 0]) * scene.motion.dq[:, 0] ** 2)


def selected(
    extra: Extra | None,
    names: Sequence[str] = SOME,
    options: Options | None = None,
    stages: Stages | None = None,
) -> Selected:
    ground = ground_of(arm_scenes(extra), stages)
    return select(ground, options, [CATALOGUE[name] for name in names]).told()


def keys(found: Selected) -> list[tuple[str, int | None]]:
    return [one.term.key for one in found.taken]


@pytest.fixture(scope="module")
def pair() -> Selected:
    return selected(both)


def test_nothing_is_taken_where_the_model_is_right() -> None:
    assert keys(selected(None)) == []


def test_both_effects_are_taken_at_their_joints(pair: Selected) -> None:
    assert sorted(keys(pair), key=str) == [("quadratic_drag", 0), ("stribeck", 1)]


def test_settings_and_coefficients_are_the_true_ones(pair: Selected) -> None:
    found = {one.term.name: one.term for one in pair.taken}
    what = found["stribeck"].what
    assert isinstance(what, Candidate)
    assert what.settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.1)
    model, drag = pair.model, found["quadratic_drag"]
    value = model.linear.theta[model.where(drag)][0]
    error = np.sqrt(model.covariance(drag)[0, 0])
    assert abs(value - DRAG) < 4.0 * error < 0.1 * DRAG


@pytest.mark.slow
def test_names_are_sure_where_no_rival_comes_near(pair: Selected) -> None:
    for one in pair.taken:
        assert named(one).confidence > 0.9


def test_what_no_effect_explains_is_a_smooth_function() -> None:
    found = selected(at_joint(0, waves))
    (one,) = found.taken[:1]
    assert one.term.smooth
    assert one.term.joint == 0
    with_it, without = found.model.linear.left_out[0], one.left[0]
    assert Options.improvement < one.share <= 1.0 - np.sum(with_it**2) / np.sum(without**2) + 1e-9


def gain_and_losses(scene: Scene) -> Array:
    """A motor that tells a third too much, and losses of a sixteenth of that."""
    return np.asarray(
        0.3 * scene.modelled[:, 0] + 0.02 * np.abs(scene.load[:, 0]) * scene.sign[:, 0]
    )


@pytest.mark.parametrize(("likeness", "told"), [(0.0, 2), (0.2, 1)])
def test_the_lesser_of_two_that_look_alike_may_be_the_error_of_the_other(
    likeness: float, told: int
) -> None:
    names, options = ("torque_constant", "load_dependent_friction"), Options(likeness=likeness)
    found = selected(at_joint(0, gain_and_losses), names, options)
    assert keys(found) == [("torque_constant", 0), ("load_dependent_friction", 0)][:told]
    assert len(found.model.terms) == 2  # for the other one's sake


@pytest.mark.parametrize(("apart", "told"), [(0.0, 2), (0.2, 1)])
def test_where_motor_and_link_move_apart_a_law_has_a_bound_of_its_own(
    apart: float, told: int
) -> None:
    gain = type(CATALOGUE["torque_constant"])()
    gain.apart = True
    catalogue, options = (
        [gain, CATALOGUE["load_dependent_friction"]],
        Options(likeness=0.0, apart=apart),
    )
    ground = ground_of(arm_scenes(at_joint(0, gain_and_losses)), None)
    found = select(ground, options, catalogue).told()
    assert keys(found) == [("torque_constant", 0), ("load_dependent_friction", 0)][:told]


@pytest.mark.slow
def test_rivals_of_a_term_hold_it_first_and_what_hides_is_known(pair: Selected) -> None:
    for taken in pair.taken:
        totals = [rival.predicted.total for rival in taken.rivals]
        assert taken.rivals[0].term is taken.term
        assert totals == sorted(totals, reverse=True)
        joint = taken.term.joint
        assert joint is not None
        assert taken.without[joint] > 1.2 * pair.model.rms()[joint]
    assert not {taken.term.key for taken in pair.taken} & set(pair.visible)
    assert all(0.0 <= share <= 1.0 for share in pair.visible.values())


def test_a_payload_of_all_logs_is_seen_where_the_file_was_before_it() -> None:
    stages = file_of(arm_scenes()[0])
    names = ("payload", "base_tilt", "spring", "torque_constant", "stribeck")
    found = selected(payload, names, stages=stages)
    assert ("payload", None) in keys(found)
    assert found.model.hold == HELD


def test_what_a_free_base_takes_up_is_gained_from_the_file() -> None:
    """Blocks of time do not miss it: the base leaves the file to explain them."""
    stages = file_of(arm_scenes()[0])
    model = Model(ground_of(arm_scenes(payload), stages), FREE)
    (term,) = terms.effects(
        model.ground.stage,
        [Candidate(CATALOGUE["payload"], None, {"from_log": 0.0})],
        model.ground.size,
    )
    model.terms.append(term)
    model.settle()
    told = model.beside(term).predicted([term.part])[0]
    assert told.file > 10.0 * max(float(told.density.sum()), 1.0)


@pytest.mark.parametrize("drive", [0, 1])
def test_a_coupled_pair_is_named_once(drive: int) -> None:
    """Whichever joint's drive it is: the two have the same columns."""

    def coupled(scene: Scene) -> Array:
        settings = {"neighbour": 1.0 - 2.0 * drive, "ratio": 1.0}
        X = CATALOGUE["transmission_coupling"].columns(scene, drive, settings)
        c = np.array([1.5, 0.3, 0.02])
        return np.stack([X[j] @ c for j in (0, 1)], axis=1)

    (taken,) = selected(coupled, ["transmission_coupling"]).taken
    assert taken.term.name == "transmission_coupling"
    assert isinstance(taken.term.what, Candidate)
    assert taken.term.what.settings["ratio"] == 1.0


def shaken(scene: Scene) -> Array:
    """A ripple of the second drive whose fast waves move the arm instead of the drive's current."""
    gear, v = scene.gear[1], scene.motion.dq[:, 1]
    wave = WAVE * np.exp(1j * gear * scene.motion.q[:, 1])
    answered = wave / (1.0 + (gear * v / LOOP) ** 4)
    return np.stack([np.zeros(scene.samples), answered.imag], axis=1)


@pytest.mark.slow
def test_a_ripple_is_told_where_the_drive_holds_against_it() -> None:
    found = selected(shaken, ["torque_ripple"])
    assert keys(found)[0] == ("torque_ripple", 1)
    term = found.taken[0].term
    assert isinstance(term.what, Candidate)
    assert term.what.settings == {"order": 1.0, "law": 0.0, "lag": 0.0}
    amplitude = float(np.hypot(*found.model.coefficients(term)))
    assert amplitude == pytest.approx(WAVE, rel=0.05)  # above the cut-off the arm gives way


def lagging(scene: Scene) -> Array:
    return np.asarray(LATE_S * scene.motion.rate_hz * np.gradient(scene.modelled, axis=0))


def stamped_late(scene: Scene) -> Array:
    at = np.arange(scene.samples) - LATE_S * scene.motion.rate_hz
    late = [np.interp(at, np.arange(scene.samples), tau) for tau in scene.modelled.T]
    return np.asarray(np.stack(late, axis=1) - scene.modelled)


@pytest.mark.parametrize(
    ("extra", "name"), [(lagging, "actuator_lag"), (stamped_late, "time_skew")]
)
def test_one_lag_of_all_drives_is_no_skew_of_the_log(extra: Extra, name: str) -> None:
    ground = ground_of(arm_scenes(extra, noise=(0.03, 0.01)))
    found = select(ground, None, [CATALOGUE["actuator_lag"], CATALOGUE["time_skew"]]).told()
    term = found.taken[0].term
    assert term.key == (name, None)
    assert found.model.coefficients(term)[0] == pytest.approx(LATE_S, rel=0.1)


def creeping(scene: Scene) -> Array:
    """An offset of the second joint's torque that drifts."""
    return np.asarray(0.8 + 0.01 * scene.time)


def test_one_effect_goes_before_two_that_explain_as_much() -> None:
    ground = ground_of(arm_scenes(at_joint(1, creeping)))
    drift = Candidate(CATALOGUE["drift"], 1, {"duration": 100.0})
    bias = Candidate(CATALOGUE["torque_bias"], 1, {})
    one, of_two = terms.effects(ground.stage, [drift, bias], ground.size)
    smooth = terms.smooth_terms(ground.stage, 1, ground.size)
    rest = next(t for t in smooth if t.name == "time of all logs")
    model = Model(ground, HELD)
    model.terms = [of_two, rest]
    model.settle()
    found = Selection(model, Options(), [])
    found.merged()
    assert model.terms == [of_two, rest]
    found._tied = {of_two.key: [one]}
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
    ground = ground_of(arm_scenes(at_joint(1, law)))
    loss = Candidate(CATALOGUE["load_dependent_friction"], 1, {})
    (effect,) = terms.effects(ground.stage, [loss], ground.size)
    smooth = terms.smooth_terms(ground.stage, 1, ground.size)
    model = Model(ground, HELD)
    model.terms = [effect, next(t for t in smooth if t.name == "load x direction")]
    model.settle()
    assert keys(Selection(model, Options(), []).told(0.0)) == [(told, 1)]
