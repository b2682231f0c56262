"""Every effect of a refined file is in exported code, as `predict` says it."""

import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as replace_struct

from seqid_cli.effects import registry
from seqid_cli.effects.effect import Coefficient, Columns, Effect, Settings
from seqid_cli.effects.fitted import Fitted, FittedEffect
from seqid_cli.effects.law import Law
from seqid_cli.effects.quadratic_drag import QuadraticDrag
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.smooth import Axis, SmoothTerm
from seqid_cli.errors import ConfigError
from seqid_cli.export.code import identifier
from seqid_cli.export.formats import export
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.logs.read import read_recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import Nuisance, Stages
from seqid_cli.robot.formula import parse_formula
from seqid_cli.robot.types import OwnEffect, Robot
from tests import Array
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import NAMES_GANTRY, urdf_gantry
from tests.plants.robots.stages import SAMPLES
from tests.unit.export.arms import made
from tests.unit.export.compiled import run_c
from tests.unit.export.motions import (
    CASES,
    CC,
    RATE_HZ,
    Case,
    arm,
    case,
    catalogue_cases,
    exported,
    fitted,
    is_modelled,
    low_passed,
    module_of,
    moving_scene,
    predicted,
    rows_of,
    share_missed,
    stepped,
    with_effects,
    without_friction,
)

FEW = 60  # samples over which C and numpy are compared
CLOSE = 0.02  # of the effect's RMS
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler here")


class Plain:
    """The arm without effects, and what its exported code says over a motion."""

    def __init__(self, folder: Path, robot: Robot, stages: Stages) -> None:
        self.robot, self.stages, self.folder = robot, stages, folder
        self.scene = moving_scene(robot, stages)
        self.rows = rows_of(self.scene)
        self.frictionless = without_friction(stages)
        self.torque = exported(folder, robot, stages, self.rows)
        self.smooth = exported(folder, robot, self.frictionless, self.rows)

    def added(self, items: Sequence[Fitted], *, robot: Robot | None = None) -> Array:
        """Return what effects add to exported torque, low-passed like that of the first
        of them.
        """
        robot = robot or self.robot
        stages = with_effects(self.stages, robot, items)
        whole = exported(self.folder, robot, stages, self.rows) - self.torque
        smooth = whole
        if is_modelled(items[0]):
            bare = with_effects(self.frictionless, robot, items)
            smooth = exported(self.folder, robot, bare, self.rows) - self.smooth
        return low_passed(self.scene, whole, smooth, items[0])

    def missed(self, items: Sequence[Fitted], *, robot: Robot | None = None) -> float:
        """Return by what share the exported effects miss those of `predict`."""
        robot = robot or self.robot
        scene = replace(
            self.scene, robot=robot, model=replace(self.scene.model, robot=robot)
        )
        stages = with_effects(self.stages, robot, items)
        return share_missed(
            scene, self.added(items, robot=robot), predicted(scene, stages)
        )

    def check_both_forms(
        self, items: Sequence[Fitted], *, robot: Robot | None = None
    ) -> None:
        """The numpy module steps as the C header does."""
        robot = robot or self.robot
        stages, rows = with_effects(self.stages, robot, items), self.rows[:FEW]
        found = stepped(module_of(robot, stages), rows)
        expected = exported(self.folder, robot, stages, rows)
        np.testing.assert_allclose(
            found, expected, rtol=0, atol=1e-8 * np.abs(expected).max()
        )


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Plain:
    return Plain(tmp_path_factory.mktemp("arm"), *arm())


def test_every_effect_of_the_catalogue_has_a_case() -> None:
    assert set(CASES) == set(CATALOGUE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "one"), catalogue_cases(), ids=lambda x: x if isinstance(x, str) else ""
)
def test_exported_effects_are_those_of_predict(
    plain: Plain, name: str, one: Case
) -> None:
    item = fitted(CATALOGUE[name], one)
    if name == "external_contact":
        assert not plain.added([item]).any()
        return
    assert plain.missed([item]) < CLOSE
    plain.check_both_forms([item])


@pytest.mark.slow
def test_friction_that_the_file_found_is_in_the_torque(plain: Plain) -> None:
    """Stribeck and load-dependent friction: what left effects out missed all of it."""
    items = [
        fitted(CATALOGUE["stribeck"], CASES["stribeck"][0]),
        fitted(
            CATALOGUE["load_dependent_friction"], CASES["load_dependent_friction"][0]
        ),
    ]
    stages = with_effects(plain.stages, plain.robot, items)
    scene, module = plain.scene, module_of(plain.robot, stages)
    motion = scene.motion
    every = slice(0, None, 10)
    states = zip(motion.q[every], motion.dq[every], motion.ddq[every], strict=True)
    found = np.array([module.torque(*state) for state in states])
    effects = sum(column for item in items for column in in_columns(scene, item))
    model = TorqueModel.from_stages(plain.stages, plain.robot)
    expected = scene.rigid + model.friction(motion.q, motion.dq) + effects
    np.testing.assert_allclose(
        found, expected[every], rtol=0, atol=1e-9 * np.abs(expected).max()
    )


def in_columns(scene: Scene, item: Fitted) -> list[Array]:
    """Return the unfiltered torque (N, n) of an effect as columns of its joints."""
    total = np.zeros_like(scene.motion.q)
    for j, torque in item.torques(scene).items():
        total[:, j] += torque
    return [total]


def test_all_effects_at_once_are_their_sum(plain: Plain) -> None:
    """Each sees the model without the others."""
    items = [fitted(CATALOGUE[name], CASES[name][0]) for name in CATALOGUE]
    items.sort(key=lambda item: item.passes)  # the first says the low-pass: see below
    scene = plain.scene
    stages = with_effects(plain.stages, plain.robot, items)
    whole = exported(plain.folder, plain.robot, stages, plain.rows) - plain.torque
    # All of it twice through the low-pass, which changes slow torque little.
    expected = scene.motion.filtered(
        sum(column for item in items for column in in_columns(scene, item)), times=2
    )
    assert share_missed(scene, scene.motion.filtered(whole, times=2), expected) < CLOSE
    plain.check_both_forms(items)


@pytest.mark.slow
def test_effects_of_an_arm_with_coupled_rotors_and_slides(tmp_path: Path) -> None:
    """Deviations of links and encoders where rotors turn the links that carry them."""
    robot, stages = made(tmp_path, urdf_gantry(), NAMES_GANTRY, 8, known=True)
    stages.inertia.rotor_coupling = "gyroscopic"
    items = [
        fitted(CATALOGUE["encoder_eccentricity"], case(2, 1e-3, -2e-3, order=0.02)),
        fitted(CATALOGUE["load_dependent_friction"], case(1, 0.1)),
        fitted(CATALOGUE["rotor_inertia"], case(2, 2e-5, coupling=0.0)),
        fitted(CATALOGUE["stribeck"], case(0, 0.5, stribeck_speed=0.1, exponent=2.0)),
        fitted(CATALOGUE["backlash"], case(2, 2e-3, trial_gap=2e-3)),
    ]
    arm_of_slides = Plain(tmp_path, robot, stages)
    scene = arm_of_slides.scene
    refined = with_effects(stages, robot, items)
    whole = (
        exported(tmp_path, robot, refined, arm_of_slides.rows) - arm_of_slides.torque
    )
    total = sum(column for item in items for column in in_columns(scene, item))
    found, expected = (scene.motion.filtered(x, times=2) for x in (whole, total))
    assert share_missed(scene, found, expected) < CLOSE
    arm_of_slides.check_both_forms(items)


@pytest.mark.slow
def test_formulas_of_a_robot_file_are_written_out(plain: Plain) -> None:
    text = (
        "c7*(-v*q)**2 + c1*sign(dq)*abs(load) - c2*tanh(dq_1/w)**2"
        " + c3*max(theta, tau)/(1 + abs(friction_1))"
        " - (c4*sin(t) - 2*c5*sqrt(abs(q))*sign(ddq))/3 + c6*(temperature_2 - 20)*dq"
    )
    ranges = {"v": (-1.0, 1.0), "w": (0.1, 1.0)}
    asked = OwnEffect("drag", 1, parse_formula(text, 2, ("v", "w")), ranges)
    robot = replace(plain.robot, effects=(asked,))
    effect = registry.catalogue_of(robot)["drag"]
    item = fitted(effect, case(1, 0.1, 0.5, 0.02, 0.3, 0.2, 0.05, 0.3, v=-0.4, w=0.5))
    assert plain.missed([item], robot=robot) < CLOSE
    plain.check_both_forms([item], robot=robot)


LOAD = Axis("load_size", 0, (0.0, 5.0, 20.0, 60.0))
PLACE = Axis("position", 1, (-1.0, -0.2, 0.4, 1.0))
SMOOTH = {
    "two axes": ((PLACE, LOAD), "direction"),
    "temperature": ((Axis("temperature", 0, (20.0, 30.0, 45.0)),), "one"),
    "time": (
        (Axis("time", 0, (0.0, 2.0, 4.0)), Axis("velocity", 0, (-2.0, 2.0))),
        "one",
    ),
    "recent speed": (
        (PLACE, Axis("recent_speed", 0, (0.0, 0.3, 1.0), seconds=0.5)),
        "direction",
    ),
    "session": ((Axis("session_time", 0, (40.0, 42.0, 46.0)),), "direction"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_terms_of_no_known_cause_are_written_out(
    plain: Plain, name: str
) -> None:
    axes, factor = SMOOTH[name]
    size = int(np.prod([axis.size for axis in axes]))
    c = np.random.default_rng(4).normal(size=size)
    item = SmoothTerm(
        joint=1, quantities=("position",), axes=axes, factor=factor, coefficients=c
    )
    assert plain.missed([item]) < 1e-9
    plain.check_both_forms([item])


def late_and_warm(stages: Stages) -> Stages:
    """Return the stages with the terms of drives: delays, and friction per kelvin."""
    terms = {"delay": (0.004, 0.0013), "thermal": (-0.01, 0.02)}
    joints = {
        name: replace_struct(
            joint,
            temperature=25.0,
            nuisances=[
                Nuisance(name=term, joint=name, value=values[k], std_error=0.0, unit="")
                for term, values in terms.items()
            ],
        )
        for k, (name, joint) in enumerate(stages.friction.joints.items())
    }
    return replace_struct(
        stages, friction=replace_struct(stages.friction, joints=joints)
    )


def test_terms_of_drives_are_those_of_predict(plain: Plain) -> None:
    robot, stages = plain.robot, late_and_warm(plain.stages)
    model = TorqueModel.from_stages(stages, robot)
    scene = moving_scene(robot, stages)
    smooth = exported(plain.folder, robot, without_friction(stages), plain.rows)
    whole = exported(plain.folder, robot, stages, plain.rows)
    motion = scene.motion
    found = motion.filtered(smooth) + motion.filtered(whole - smooth, times=2)
    assert share_missed(scene, found, model.predict(motion)) < 1e-3
    changed = np.abs(whole - plain.torque).max()
    assert changed > 0.05 * np.abs(plain.torque).max()
    np.testing.assert_allclose(
        stepped(module_of(robot, stages), plain.rows[:FEW]),
        whole[:FEW],
        atol=1e-8 * changed,
    )


def test_a_feed_forward_leaves_out_delays_and_lags(plain: Plain) -> None:
    """`as_logged` says whether the torque is as it is logged."""
    robot = plain.robot
    items = [
        fitted(CATALOGUE[name], CASES[name][0])
        for name in ("time_skew", "actuator_lag")
    ]
    stages = replace_struct(
        with_effects(plain.stages, robot, items),
        friction=late_and_warm(plain.stages).friction,
    )
    cold = plain.rows.copy()
    cold[:, 6:8] = np.nan
    rows = cold[:FEW]
    logged, wanted = (
        stepped(module_of(robot, stages), rows, as_logged=x) for x in (True, False)
    )
    np.testing.assert_allclose(wanted, plain.torque[:FEW], atol=1e-8)
    assert np.abs(logged - wanted).max() > 1e-3
    if CC is not None:
        body = (
            "static ARM_state s; if (row == 0) { ARM_start(&s, x); s.as_logged = 0; }"
            f" ARM_step(&s, x, x + N, x + 2 * N, 0, x[4 * N], {1.0 / RATE_HZ!r}, y);"
        )
        header = export(robot, stages, kind="C header").text
        assert "as_logged" in header.split("#ifndef")[0]
        np.testing.assert_allclose(
            run_c(plain.folder, robot, header, body, np.nan_to_num(rows)),
            wanted,
            atol=1e-8,
        )


def test_the_observer_knows_what_a_spring_holds(plain: Plain) -> None:
    """An arm that rests on a spring, by torque of an offset channel, is not pushed."""
    items = [
        fitted(CATALOGUE[name], CASES[name][0]) for name in ("spring", "torque_bias")
    ]
    module = module_of(plain.robot, with_effects(plain.stages, plain.robot, items))
    q, rest = plain.rows[0, :2], np.zeros(2)
    tau = module.torque(q, rest, rest)
    assert np.abs(tau - module.rigid_torque(q, rest, rest)).max() > 0.5
    observer = module.Observer(q, tau)
    for _ in range(200):
        pushed = observer.update(q, tau, 1e-3)
    assert not pushed.any()
    np.testing.assert_allclose(observer.external, 0.0, atol=1e-9)


class Named(QuadraticDrag):
    """One whose parts have names that code has for something else."""

    name = "mine"

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        parts = {"load": "dq * abs(dq)", "double": "load + 0.0 * tau"}
        return {joint: Law(terms=("double",), parts=parts)}


class Silent(Effect):
    """A package's effect whose law is known to itself alone."""

    name = "mine"
    family = "friction"
    linear = (Coefficient("damping", "N m s/rad"),)

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        return {joint: scene.motion.dq[:, [joint]]}


class Deviating(QuadraticDrag):
    """One that inherits a law, and computes something else."""

    name = "mine"

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        return {joint: scene.motion.dq[:, [joint]] ** 3}


class Declaring(QuadraticDrag):
    """One that says nothing else than the law that it inherits."""

    name = "mine"


@pytest.mark.parametrize("kind", [Silent, Deviating])
@pytest.mark.parametrize("form", ["C header", "numpy module"])
def test_an_effect_without_a_law_is_refused_by_its_name(
    plain: Plain, monkeypatch: pytest.MonkeyPatch, kind: type[Effect], form: str
) -> None:
    monkeypatch.setattr(registry, "own_effect", lambda asked, robot: kind())
    robot = replace(plain.robot, effects=(OwnEffect("mine"),))
    item = FittedEffect(
        effect=kind(),
        joint=1,
        settings={},
        coefficients=np.ones(1),
        covariance=np.eye(1),
    )
    stages = with_effects(plain.stages, robot, [item])
    with pytest.raises(ConfigError, match=r"'mine' \(joint_2\)") as caught:
        export(robot, stages, kind=form)
    assert caught.value.exit_code == 2
    assert caught.value.hint
    assert "left out: mine" in export(robot, stages, kind="MJCF").text


@pytest.mark.parametrize("kind", [Declaring, Named])
def test_a_packages_effect_with_a_law_is_written(
    plain: Plain, monkeypatch: pytest.MonkeyPatch, kind: type[Effect]
) -> None:
    monkeypatch.setattr(registry, "own_effect", lambda asked, robot: kind())
    robot = replace(plain.robot, effects=(OwnEffect("mine"),))
    assert plain.missed([fitted(kind(), case(1, 0.3))], robot=robot) < CLOSE


def test_a_line_whose_phase_is_of_each_log_is_a_comment(plain: Plain) -> None:
    one = case(1, 0.4, 0.3, 0.1, 0.2, frequency=7.3, clocks=2.0, span=90.0)
    item = fitted(CATALOGUE["periodic_disturbance"], one)
    assert not plain.added([item]).any()
    stages = with_effects(plain.stages, plain.robot, [item])
    for form in ("C header", "numpy module"):
        assert "7.3 Hz" in export(plain.robot, stages, kind=form).text


@needs_cc
def test_the_header_allocates_nothing(plain: Plain) -> None:
    """Neither by name nor in what the compiled file asks of others."""
    items = [fitted(CATALOGUE[name], one) for name, one in catalogue_cases()]
    stages = with_effects(plain.stages, plain.robot, items)
    text = export(plain.robot, stages, kind="C header").text
    assert not re.search(r"alloc|free\(", text.replace("no allocation", ""))
    name, folder = identifier(plain.robot.name), plain.folder
    (folder / "arm.h").write_text(text)
    (folder / "all.c").write_text(
        f'#include "arm.h"\nvoid use({name}_state *s, const double *x, double *y);\n'
        f"void use({name}_state *s, const double *x, double *y)\n"
        f"{{ {name}_start(s, x); {name}_step(s, x, x, x, x, 0.0, 1e-3, y); }}\n"
    )
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Wvla", "-Werror"]
    command = ["cc", *flags, "-c", "-o", str(folder / "all.o"), str(folder / "all.c")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    asked = set(re.findall(rb"(?:m|c|re)alloc|alloca", (folder / "all.o").read_bytes()))
    assert not asked


def test_every_field_of_the_state_is_described(plain: Plain) -> None:
    items = [fitted(CATALOGUE[name], one) for name, one in catalogue_cases()]
    stages = with_effects(plain.stages, plain.robot, items)
    text = export(plain.robot, stages, kind="C header").text
    inside = text[: text.index(f"}} {identifier(plain.robot.name)}_state;")]
    fields = inside[inside.rindex("typedef struct {") :].split("\n", 1)[1]
    comment = r"/\*(?:[^*]|\*(?!/))*\*/"
    declaration = r"[^\S\n]*\w[^;/]*;"
    described = re.compile(rf"{comment}\n{declaration}|{declaration}[^\S\n]*{comment}")
    assert ";" in fields
    assert not described.sub("", fields).strip()


def test_an_exported_file_says_of_a_log_what_predict_says(tmp_path: Path) -> None:
    """Of a recorded log, from its file to the torque; without effects all of it is
    missed.
    """
    robot = sample_robot("two_joint")
    golden = read_parameters(SAMPLES / "two_joint" / "golden.json").stages
    names = (
        "stribeck",
        "load_dependent_friction",
        "presliding_hysteresis",
        "joint_elasticity",
    )
    items = [fitted(CATALOGUE[name], CASES[name][0]) for name in names]
    stages = with_effects(golden, robot, items)
    log = read_recording(
        sorted((SAMPLES / "two_joint" / "validation").iterdir())[0], robot
    )
    (said,) = predict([log], robot, stages, options=InertiaOptions())

    rows = np.hstack(
        [said.q, said.dq, said.ddq, np.zeros_like(said.q), said.t[:, None]]
    )
    smooth_items = with_effects(without_friction(golden), robot, items[-1:])
    smooth = exported(tmp_path, robot, smooth_items, rows, rate_hz=log.rate_hz)
    whole = exported(tmp_path, robot, stages, rows, rate_hz=log.rate_hz)
    lowpass = Lowpass(said.cutoff_hz, log.rate_hz)
    found = lowpass(smooth) + lowpass(whole - smooth, times=2)

    used = said.used & (said.t > 2.0)
    missed = np.sqrt(np.mean((found - said.predicted)[used] ** 2, axis=0))
    assert (missed < 1e-3 * np.sqrt(np.mean(said.predicted[used] ** 2, axis=0))).all()
