"""Effects of one's own: formulas' columns, packages' effects, and their names."""

import pickle
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from seqid_cli.effects import own
from seqid_cli.effects.effect import Effect
from seqid_cli.effects.fitted import FittedEffect, as_stage, fitted_effects
from seqid_cli.effects.registry import CATALOGUE, catalogue_of
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.stribeck import Stribeck
from seqid_cli.errors import ConfigError
from seqid_cli.params.schema import Stages
from seqid_cli.robot.formula import parse_formula
from seqid_cli.robot.types import OwnEffect
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.effects.scenes import scene_of, wander


class Mine(Stribeck):
    name = "mine"


def asked(
    text: str, joint: int | None = None, **settings: tuple[float, float]
) -> OwnEffect:
    return OwnEffect("drag", joint, parse_formula(text, 2, settings), settings)


@pytest.fixture(scope="module")
def place() -> Scene:
    return scene_of(wander(4.0, seed=1, rests=()))


def effect_of(own_effect: OwnEffect) -> Effect:
    return catalogue_of(replace(two_joint_robot(), effects=(own_effect,)))[
        own_effect.name
    ]


def test_columns_are_what_the_formula_says(place: Scene) -> None:
    q = place.motion.q
    dq = place.motion.dq
    text = (
        "c1*sign(dq)*abs(load) - c2*tanh(dq_1/w)**2 + 3*c2*min(q, 0.1) + c3*sign(dq_1)"
    )
    columns = effect_of(asked(text, w=(0.1, 1.0))).columns(place, 1, {"w": 0.5})
    first = place.sign[:, 1] * np.abs(place.load[:, 1])
    second = 3.0 * np.minimum(q[:, 1], 0.1) - np.tanh(dq[:, 0] / 0.5) ** 2
    assert columns.keys() == {1}
    assert columns[1] == pytest.approx(
        np.column_stack([first, second, place.sign[:, 0]])
    )


@pytest.mark.parametrize(
    "name", ["q", "dq", "ddq", "theta", "load", "friction", "tau", "t"]
)
def test_every_symbol_is_a_quantity_of_its_joint(place: Scene, name: str) -> None:
    unnumbered, numbered = (
        effect_of(asked(f"c*{text}")).columns(place, 1, {})[1]
        for text in (name, f"{name}_2")
    )
    assert np.ptp(unnumbered) > 0.0
    assert np.array_equal(unnumbered, numbered)


def test_what_is_no_number_is_said_and_not_fitted(place: Scene) -> None:
    with pytest.raises(ConfigError, match=r"drag.*no finite number.*samples") as caught:
        effect_of(asked("c*log(q - q)")).columns(place, 1, {})
    assert caught.value.hint


def test_it_is_written_and_restored_and_sent_to_other_processes(place: Scene) -> None:
    robot = replace(two_joint_robot(), effects=(asked("c*sin(p*dq_1)", p=(0.5, 4.0)),))
    effect = pickle.loads(pickle.dumps(catalogue_of(robot)["drag"]))
    fitted = FittedEffect(
        effect=effect,
        joint=1,
        settings={"p": 2.0},
        coefficients=np.array([0.3]),
        covariance=np.eye(1),
    )
    stages = Stages(effects=[as_stage(fitted, robot)])
    (back,) = fitted_effects(stages, robot)
    assert back.torques(place)[1] == pytest.approx(
        0.3 * np.sin(2.0 * place.motion.dq[:, 0])
    )
    with pytest.raises(ConfigError, match="drag") as caught:  # its robot file lacks it
        fitted_effects(stages, two_joint_robot())
    assert "[[effect]]" in str(caught.value.hint)


def test_no_name_of_the_catalogue_is_taken() -> None:
    with pytest.raises(ConfigError, match="one of the catalogue"):
        effect_of(replace(asked("c*q"), name="stribeck"))


def offer(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    """A package offers an effect under this value."""

    def entry_points(**about: str) -> tuple[EntryPoint, ...]:
        point = EntryPoint("mine", value, "seqid.effects")
        return (point,) if about.get("name", "mine") == "mine" else ()

    monkeypatch.setattr(own, "entry_points", entry_points)


def test_an_effect_of_a_package_is_loaded_when_it_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    offer(monkeypatch, f"{__name__}:Mine")
    assert isinstance(effect_of(OwnEffect("mine")), Mine)
    assert catalogue_of(two_joint_robot()) == CATALOGUE


@pytest.mark.parametrize("value", ["no_such_module:Mine", ":nothing", ":offer"])
def test_a_package_that_offers_something_else_is_named(
    monkeypatch: pytest.MonkeyPatch, value: str
) -> None:
    offer(monkeypatch, value if value[0] != ":" else __name__ + value)
    with pytest.raises(ConfigError, match="mine"):
        effect_of(OwnEffect("mine"))


def test_an_effect_that_nobody_offers_is_said() -> None:
    with pytest.raises(ConfigError, match="nobodys") as caught:
        effect_of(OwnEffect("nobodys"))
    assert "torque =" in str(caught.value.hint)


def test_it_asks_for_the_temperature_that_it_names(place: Scene) -> None:
    effect = effect_of(asked("c*(temperature - 25)*dq"))
    assert not effect.available([place], 1)
    warm = replace(place, temperature=np.full_like(place.motion.q, 30.0))
    assert effect.available([warm], 1)
    assert effect.columns(warm, 1, {})[1][:, 0] == pytest.approx(
        5.0 * warm.motion.dq[:, 1]
    )


@pytest.mark.parametrize(
    ("text", "steady"),
    [
        ("c*dq**2*sign(dq)", True),
        ("c*abs(load)*sign(dq)", True),
        ("c*load", False),
        ("c*ddq*sign(dq)", False),
        ("c*temperature*sign(dq)", False),
    ],
)
def test_friction_trials_had_what_steady_motion_tells(text: str, steady: bool) -> None:
    assert effect_of(asked(text)).steady == steady
