"""What every physical effect offers, so that nothing else needs to know one by name.

An effect is a torque that is linear in a few coefficients once its settings are fixed:

    tau_effect = sum_k c_k X_k(motion; settings).

Coefficients come out of a least squares, settings (a Stribeck speed, a stiffness, a
frequency) are searched: first over a grid, then by variable projection. The sign
convention is that of the measured torque: tau_measured = model + tau_effect.

An effect says its law once, as formulas (`laws`): columns are evaluated from them, and
exported code is written from them. What no formula says is declared as a `deviation` of
a link or as `body_terms`, and has columns of its own.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, cast

import numpy as np

from seqid_cli.model.effects.declared import BodyTerm, Deviation
from seqid_cli.model.effects.law import Evaluated, Law
from seqid_cli.model.effects.scene import Scene, Scenes, moves
from seqid_cli.model.effects.smooth import MEASURES, Axis, Measure
from seqid_cli.model.effects.units import Value
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask
from seqid_cli.units import unit_of

Grid = Iterator[dict[str, float]]
GridAxes = Mapping[str, Sequence[float]]  # the values of each setting, all combined
Settings = Mapping[str, float]
# a `Joint`: each effect says whether it takes None, for the whole arm or all joints
AnyJoint = Any
# joint index -> (N, k), unfiltered, torque per unit coefficient
Columns = Mapping[int, Array]

SPACING = 2.5  # ratio of a setting to the grid's next value

Family = Literal["friction", "transmission", "body", "measurement"]
Over = Measure | Literal["driving_load", "wave", "torque"]


@dataclass(frozen=True)
class Coefficient:
    """A linear parameter: its name, unit and what values are physical.

    `unit` is for a revolute joint, with rad and N m; `low` and `high` bound what is
    believed.
    """

    name: str
    unit: str
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class Setting:
    """A parameter that the torque is not linear in.

    `low` and `high` bound the search between the grid's values; a setting that is not
    `continuous` (an order, the number of a log) keeps the grid's value. `logarithmic`
    ones are searched by ratio. A `usual` value is taken where no other does clearly
    better. From the grid's value on those of `then` are followed one after the other
    while the gain grows, with the other settings searched anew at each: of a shape that
    is found only in its blunt form. One that is not `asked` for is left out where that
    does not do clearly worse. `grid` are the values of the default grid.

    `agreement` is of a setting that is the effect's own size, near which its column is
    exact: it follows the first coefficient, and where it is not 0 the two must agree to
    this ratio.
    """

    name: str
    unit: str
    low: float = -np.inf
    high: float = np.inf
    continuous: bool = True
    logarithmic: bool = False
    usual: tuple[float, ...] = ()
    then: tuple[float, ...] = ()
    asked: bool = True
    grid: tuple[float, ...] = ()
    agreement: float | None = None

    def bracket(self, value: float, spacing: float = SPACING) -> tuple[float, float]:
        """Interval about a value that is searched; in logarithms where it is searched by ratio."""
        if self.logarithmic:
            low, high = (
                max(value / spacing, self.low, 1e-12),
                min(value * spacing, self.high),
            )
            return float(np.log(low)), float(np.log(high))
        reach = 0.5 * max(abs(value), 1e-3)
        return max(value - reach, self.low), min(value + reach, self.high)

    def agrees(self, value: float, size: float) -> bool:
        """Whether a value belongs to the size that was found with it."""
        if self.agreement is None or value == 0.0:
            return True
        return 1.0 / self.agreement <= size / value <= self.agreement

    def at(self, x: float) -> float:
        """The value at a place of such an interval."""
        return float(np.exp(x)) if self.logarithmic else float(x)


class Effect:
    """A physical effect; subclasses are stateless and live in one file each."""

    name: str  # as the contract spells it
    family: Family
    arm: bool = False  # of the whole arm or of its measurement: its joint is then None
    # Whether it can be one of all joints alike as well: its joint is then None.
    shared: bool = False
    settings: tuple[Setting, ...] = ()
    # where they are the same whatever the settings
    linear: tuple[Coefficient, ...] = ()
    # `motion`: the joint must move; `load`: the model must know the load of its gear.
    needs: tuple[Literal["motion", "load"], ...] = ()
    # How many times the log's low-pass is to be applied to the columns: 1 for smooth
    # terms in the filtered motion's derivatives, 2 for all that has steps or is finer
    # than the filter.
    passes: int = 2
    # whether it shows above the cut-off as well (a ripple, the mains)
    wide: bool = False
    # Whether it shifts torque in time: the free time offset which otherwise belongs to
    # the base model must then be taken out of it.
    timing: bool = False
    # Whether the grid's columns hold for small sizes only, so that gains count once
    # `sharpened`.
    first_order: bool = False
    # changes over minutes only, as slow noise of the measured torque does
    slow: bool = False
    # Whether a constant effect of this kind hides in the base parameters once they are
    # free: it is then visible against earlier parameters only.
    change: bool = False
    # Whether motor and link move apart, so that the parameters take the link's inertia
    # alone.
    apart: bool = False
    # Whether nothing is left of it where its coefficients are right: no law of friction
    # is.
    exact: bool = False
    # Whether its torque at a constant speed follows from posture and speed, so that it
    # is known what friction trials had of it; whether a part of that is the same both
    # ways, which gravity may have taken up.
    steady: bool = False
    even: bool = False
    # arises before a torque sensor behind the gear, which does not see it
    drive: bool = False
    # What its two coefficients are the sine and cosine of: reported as its amplitude
    # and phase.
    wave: str = ""
    # last coefficients that files of earlier versions lack: zero there
    later: tuple[str, ...] = ()
    # The quantity that its torque is shown over: one of its joint, `driving_load` (load
    # times direction, above zero where the gear drives), the place on its own `wave`
    # (columns are sine, cosine, sine, ...), or its own `torque` where no quantity alone
    # tells it.
    over: Over = "torque"
    # turns with the direction of motion: it is shown times the direction
    sided: bool = False
    # names that it can be taken for in principle, whatever the motion
    alike: tuple[str, ...] = ()
    # Effect of whose torque it is a share, the same in both directions, beside what the
    # file has.
    share_of: str = ""
    # Whether motion alone makes it show, no time, warmth or hand, so that moves can be
    # planned.
    by_motion: bool = True
    separate_by: str  # what to record to tell it from those, as an instruction

    def local(self, settings: Settings) -> bool:
        """Whether its torque at a moment follows from the motion just before and after it.

        Not so where it remembers more, or needs another channel of the log.
        """
        return True

    def axis(self, joint: int, settings: Settings) -> Axis | None:
        """Return the quantity that it is shown over at a joint; None for what it makes itself."""
        return Axis(cast(Measure, self.over), joint) if self.over in MEASURES else None

    def between(self, settings: Settings) -> tuple[Setting, ...]:
        """Settings that are searched between the grid's values."""
        return tuple(setting for setting in self.settings if setting.continuous)

    def searched(self, settings: Settings) -> int:
        """How many parameters are searched beside the coefficients."""
        return len(self.between(settings)) + sum(
            bool(one.then) for one in self.settings
        )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the linear parameters, in the order of the columns; by default `linear`."""
        return self.linear

    def laws(
        self, robot: Robot, joint: AnyJoint, settings: Settings
    ) -> Mapping[int, Law] | None:
        """Return the law at every joint that is touched; None where formulas do not say it."""
        return None

    def deviation(
        self, robot: Robot, joint: AnyJoint, settings: Settings
    ) -> Deviation | None:
        """Return how the joint's link is not where its encoder says; None where it is."""
        return None

    def body_terms(
        self, robot: Robot, joint: AnyJoint, settings: Settings
    ) -> Sequence[BodyTerm] | None:
        """Return what each coefficient changes in the rigid body; None where that stays."""
        return None

    def columns(self, scene: Scene, joint: AnyJoint, settings: Settings) -> Columns:
        """Compute the torque per unit coefficient; by default that of the `laws`.

        Parameters
        ----------
        scene : Scene
        joint : int or None
            Index of the joint; None for an effect of the whole arm or of all joints
            alike.
        settings : mapping
            A value for every setting.

        Returns
        -------
        mapping of joint index to (N, k) array
            For every joint whose torque is touched; unfiltered.
        """
        laws = self.laws(scene.robot, joint, settings)
        if laws is None:
            raise NotImplementedError(f"{self.name} has neither laws nor columns")
        shared: dict[int, dict[str, Evaluated]] = {}
        return {j: law.columns(scene, j, shared) for j, law in laws.items()}

    def steady_columns(
        self, scene: Scene, joint: AnyJoint, settings: Settings
    ) -> Columns:
        """Compute the same of joints at constant speeds, whose samples are places, not times."""
        return self.columns(scene, joint, settings)

    def available(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether robot file and channels allow to look for it; by default `needs`."""
        moving = "motion" not in self.needs or (
            joint is not None and moves(scenes, joint)
        )
        # the load of the gears
        known = all(scene.model.phi is not None for scene in scenes)
        return moving and ("load" not in self.needs or known)

    def possible(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether it may be there though it cannot be looked for: a channel is lacking."""
        return not self.available(scenes, joint)

    def grid(self, scenes: Scenes, joint: AnyJoint, residual: Sequence[Array]) -> Grid:
        """Yield the settings to try.

        Parameters
        ----------
        scenes : sequence of Scene
        joint : int or None
        residual : sequence of (N, n) arrays
            Measured minus modelled torque of each scene, low-passed like its motion's
            torque (unfiltered for `wide` effects); zero where it does not count.
        """
        axes = self.axes(scenes, joint)
        for values in product(*axes.values()):
            yield dict(zip(axes, values, strict=True))

    def beyond(self, scenes: Scenes, joint: AnyJoint) -> Grid:
        """Yield first values of settings that are not asked for."""
        return iter(())

    def axes(self, scenes: Scenes, joint: AnyJoint) -> GridAxes:
        """Return the grid's values of each setting; the default `grid` is their product."""
        return {setting.name: setting.grid for setting in self.settings if setting.grid}

    def simpler(self, settings: Settings) -> dict[str, float] | None:
        """Return settings of the same effect with fewer coefficients; None where there are none."""
        return None

    def reached(self, settings: Settings, *, points: int = 15) -> Grid:
        """Yield settings at which a search from a grid's may end, `points` to every interval."""
        yield dict(settings)
        for one in self.between(settings):
            low, high = one.bracket(settings[one.name])
            for x in np.linspace(low, high, points):
                yield {**settings, one.name: one.at(float(x))}
        for one in self.settings:
            for value in (*one.usual, *one.then):
                yield {**settings, one.name: value}

    def sharpened(self, settings: Settings, c: Array) -> dict[str, float] | None:
        """Return settings nearer to what coefficients c (k,) say; None where there are none.

        For columns that are exact only near the effect's true size.
        """
        own = [setting for setting in self.settings if setting.agreement is not None]
        return {
            one.name: float(np.clip(c[0], one.low, one.high)) for one in own
        } or None

    def guessed(
        self, scene: Scene, joint: AnyJoint, settings: Settings
    ) -> Mapping[int, Mask]:
        """Return, by joint, samples (N,) of unknown torque: where something sticks, say."""
        return {}

    def reported(
        self,
        robot: Robot,
        joint: AnyJoint,
        settings: Settings,
        c: Array,
        covariance: Array,
    ) -> list[Value]:
        """Return the `values`, or none where something is `lacking` that they stand on."""
        if self.lacking(robot, joint):
            return []
        return self.values(robot, joint, settings, c, covariance)

    def values(
        self,
        robot: Robot,
        joint: AnyJoint,
        settings: Settings,
        c: Array,
        covariance: Array,
    ) -> list[Value]:
        """Return the physical parameters of coefficients c (k,) with their covariance (k, k)."""
        specs = self.coefficients(settings)
        slides = joint is not None and robot.joints[joint].prismatic
        # c_0 sin(p) + c_1 cos(p) = A sin(p + phase), errors by the delta method
        if self.wave:
            amplitude, phase = (
                float(np.hypot(c[0], c[1])),
                float(np.arctan2(c[1], c[0])),
            )
            scale = max(amplitude, 1e-300)
            slopes = np.array([[c[0], c[1]], [-c[1] / scale, c[0] / scale]]) / scale
            error = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
            unit = unit_of(specs[0].unit, slides)
            return [
                Value(f"{self.wave}_amplitude", amplitude, float(error[0]), unit),
                Value(f"{self.wave}_phase", phase, float(error[1]), "rad"),
            ]
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return [
            Value(spec.name, float(x), float(e), unit_of(spec.unit, slides))
            for spec, x, e in zip(specs, c, errors, strict=True)
        ]

    def lacking(self, robot: Robot, joint: AnyJoint) -> str:
        """Return why the parameters do not follow from what is found; empty where they do."""
        if not self.apart or joint is None or not rotor_hidden(robot, joint):
            return ""
        return (
            "no motion tells the rotor's inertia from the link's here, and the"
            " parameters take the link's alone: give rotor_inertia of"
            f" {robot.joint_names[joint]} in the robot file"
        )

    def plausible(
        self, scenes: Scenes, joint: AnyJoint, settings: Settings, c: Array
    ) -> bool:
        """Return whether coefficients c (k,) are physical: in bounds, and of the size set."""
        specs = self.coefficients(settings)
        bounded = all(
            spec.low <= x <= spec.high for spec, x in zip(specs, c, strict=True)
        )
        size, own = float(c[0]) if len(c) else 0.0, self.settings
        return bounded and all(x.agrees(settings.get(x.name, 0.0), size) for x in own)


class FrictionLaw(Effect):
    """Friction of one joint: a torque sensor behind the gear does not see it."""

    family = "friction"
    drive = True
    needs: tuple[Literal["motion", "load"], ...] = ("motion",)


def rotor_hidden(robot: Robot, joint: int) -> bool:
    """Whether neither the robot file nor any motion tells a rotor's inertia from the link's."""
    known = robot.joints[joint].rotor_inertia is not None
    return not known and f"Ia_{joint + 1}" not in free_basis(robot).names
