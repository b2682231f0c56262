"""What every physical effect offers, so that nothing else needs to know one by name.

An effect is a torque that is linear in a few coefficients once its settings are fixed:

    tau_effect = sum_k c_k X_k(motion; settings).

Coefficients come out of a least squares, settings (a Stribeck speed, a stiffness, a
frequency) are searched: first over a grid, then by variable projection. The sign
convention is that of the measured torque: tau_measured = model + tau_effect.

An effect says its law once, as formulas (`laws`): columns are evaluated from them, and
exported code is written from them. What no formula says is declared as a `deviation` of
a link or as `body_terms`, and has columns of its own.

Symbols: N samples, n joints, k coefficients; `c` (k,) their values, `covariance` (k, k)
that of `c`.

The class `Effect` has two groups of members. The interface comes first: what a search
asks every effect for. Most effects set its attributes and give their columns by `laws`,
the first of the further declarations. The others of these are of one or two effects
each, and their defaults suit all others.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from itertools import product
from typing import Any, Literal, cast

import numpy as np

from seqid_cli.effects.declared import BodyTerm, Deviation
from seqid_cli.effects.law import Evaluated, Law
from seqid_cli.effects.scene import Scene, Scenes, moves
from seqid_cli.effects.smooth import MEASURES, Axis, Measure
from seqid_cli.effects.units import Value
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask
from seqid_cli.units import unit_of

Grid = Iterator[dict[str, float]]
GridAxes = Mapping[str, Sequence[float]]  # the values of each setting, all combined
Settings = Mapping[str, float]
# A `Joint`: each effect says whether it takes None, for the whole arm or all joints.
AnyJoint = Any
# Joint index -> (N, k), unfiltered, torque per unit coefficient.
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

    Attributes
    ----------
    name, unit : str
        Name as it stands in files; unit for a revolute joint.
    low, high : float
        Bounds of the search between the grid's values.
    continuous : bool
        Whether values between those of the grid are searched. A setting that is not
        continuous (an order, the number of a log) keeps the grid's value.
    logarithmic : bool
        Whether it is searched by ratio instead of by difference.
    usual : tuple of float
        Values that are taken where no other does clearly better.
    then : tuple of float
        Values that are tried after that of the grid, one after the other while the gain
        grows, with the other settings searched anew at each: for a shape that is found
        only in its blunt form.
    asked : bool
        Whether it must be given. One that is not asked for is left out where that does
        not do clearly worse.
    grid : tuple of float
        Values of the default grid.
    agreement : float, optional
        For a setting that is the effect's own size, near which its column is exact. The
        setting follows the first coefficient; where it is not 0, both must agree to
        this ratio.
    """

    name: str
    unit: str
    _: KW_ONLY
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
        """Return the interval about a value that is searched.

        Its ends are logarithms where the setting is searched by ratio.
        """
        if self.logarithmic:
            low = max(value / spacing, self.low, 1e-12)
            high = min(value * spacing, self.high)
            return float(np.log(low)), float(np.log(high))

        reach = 0.5 * max(abs(value), 1e-3)
        return max(value - reach, self.low), min(value + reach, self.high)

    def agrees(self, value: float, size: float) -> bool:
        """Return whether a value belongs to the size that was found with it."""
        if self.agreement is None or value == 0.0:
            return True
        return 1.0 / self.agreement <= size / value <= self.agreement

    def at(self, x: float) -> float:
        """Return the value at a place of the interval that `bracket` gives."""
        return float(np.exp(x)) if self.logarithmic else float(x)


FROM_LOG = "from_log"
# Of a change of the file's values: the log from which on it is there, where that is not
# the first one.
SINCE_LOG = Setting(FROM_LOG, "1", low=0.0, continuous=False, asked=False)


def acts_in_log(number: int, settings: Settings) -> bool:
    """Return whether an effect is there in a log of a session, by its number."""
    return number >= settings.get(FROM_LOG, -np.inf)


@dataclass(frozen=True)
class Mirrored:
    """The same effect, seen from another joint that it touches."""

    joint: int
    settings: dict[str, float]


class Effect:
    """A physical effect; subclasses are stateless and live in one file each."""

    # ---- The interface ------------------------------------------------------------

    name: str  # as files and commands spell it
    family: Family
    settings: tuple[Setting, ...] = ()
    # Coefficients where they are the same whatever the settings.
    linear: tuple[Coefficient, ...] = ()
    # The quantity that the torque is shown over: one of its joint, `driving_load` (load
    # times direction, above zero where the gear drives), the place on the effect's
    # `wave` (columns are sine, cosine, sine, ...), or its own `torque` where no
    # quantity alone tells it.
    over: Over = "torque"
    # Whether the torque turns with the direction of motion: it is then shown times the
    # direction.
    sided: bool = False
    # Names of effects that it can be taken for in principle, whatever the motion.
    alike: tuple[str, ...] = ()
    separate_by: str  # what to record to tell it from those, as an instruction

    def available(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether robot file and channels allow to look for the effect."""
        return True

    def grid(self, scenes: Scenes, joint: AnyJoint, residual: Sequence[Array]) -> Grid:
        """Yield the settings to try; by default all combinations of the `axes`.

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

        # Parts that the laws of several joints share are evaluated once.
        shared: dict[int, dict[str, Evaluated]] = {}
        return {j: law.columns(scene, j, shared) for j, law in laws.items()}

    def columns_in_log(
        self, scene: Scene, joint: AnyJoint, settings: Settings
    ) -> Columns:
        """Compute the `columns`, zero in a log before the effect came."""
        columns = self.columns(scene, joint, settings)
        if acts_in_log(scene.log, settings):
            return columns
        return {j: np.zeros_like(X) for j, X in columns.items()}

    def values(
        self,
        robot: Robot,
        joint: AnyJoint,
        settings: Settings,
        c: Array,
        covariance: Array,
    ) -> list[Value]:
        """Return the physical parameters that the coefficients stand for.

        Parameters
        ----------
        robot : Robot
        joint : int or None
        settings : mapping
        c, covariance : array
            Coefficients (k,) and their covariance (k, k).

        Returns
        -------
        list of Value
            By default the coefficients themselves, in the units of the joint.
        """
        specs = self.coefficients(settings)
        prismatic = joint is not None and robot.joints[joint].prismatic
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return [
            Value(spec.name, float(x), float(error), unit_of(spec.unit, prismatic))
            for spec, x, error in zip(specs, c, errors, strict=True)
        ]

    def plausible(
        self, scenes: Scenes, joint: AnyJoint, settings: Settings, c: Array
    ) -> bool:
        """Return whether coefficients c (k,) are physical.

        They are within their bounds, and agree with the settings of their size.
        """
        specs = self.coefficients(settings)
        bounded = all(
            spec.low <= x <= spec.high for spec, x in zip(specs, c, strict=True)
        )
        size = float(c[0]) if len(c) else 0.0
        return bounded and all(
            setting.agrees(settings.get(setting.name, 0.0), size)
            for setting in self.settings
        )

    def can_exist(self, scenes: Scenes, c: Array, covariance: Array) -> bool:
        """Return whether something with these coefficients can be, within their errors.

        Parameters
        ----------
        scenes : sequence of Scene
        c, covariance : array
            Coefficients (k,) and their covariance (k, k).
        """
        return True

    # ---- Further declarations: how its law is stated --------------------------------

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the linear parameters in the order of the columns."""
        return self.linear

    def laws(
        self, robot: Robot, joint: AnyJoint, settings: Settings
    ) -> Mapping[int, Law] | None:
        """Return the law at every touched joint; None if formulas do not say it."""
        return None

    def deviation(
        self, robot: Robot, joint: AnyJoint, settings: Settings
    ) -> Deviation | None:
        """Return how the joint's link is not where its encoder says; None if it is."""
        return None

    def link_angle(
        self, scene: Scene, joint: AnyJoint, settings: Settings
    ) -> Array | None:
        """Return the angle (N, k) by which the link is ahead of its encoder.

        It is per unit coefficient, and shows in an IMU on the link. None where link and
        encoder turn as one.
        """
        return None

    def body_terms(
        self, robot: Robot, joint: AnyJoint, settings: Settings
    ) -> Sequence[BodyTerm] | None:
        """Return what each coefficient changes in the rigid body; None if nothing."""
        return None

    def steady_columns(
        self, scene: Scene, joint: AnyJoint, settings: Settings
    ) -> Columns:
        """Compute columns at constant speeds: samples are places, not times."""
        return self.columns(scene, joint, settings)

    def local(self, settings: Settings) -> bool:
        """Return whether the torque at a moment follows from the motion around it.

        It does not where the effect remembers more, or needs another channel of the
        log.
        """
        return True

    def guessed(
        self, scene: Scene, joint: AnyJoint, settings: Settings
    ) -> Mapping[int, Mask]:
        """Return samples (N,) of unknown torque by joint: where a drive sticks, say."""
        return {}

    # ---- Further declarations: what it acts on --------------------------------------

    # Whether it is of the whole arm or of its measurement: its joint is then None.
    arm: bool = False
    # Whether it can be one of all joints alike as well: its joint is then None.
    shared: bool = False
    # Whether it arises before a torque sensor behind the gear, which does not see it.
    drive: bool = False
    # Whether motor and link move apart, so that the parameters take the link's inertia
    # alone.
    apart: bool = False
    # Name of an effect of whose torque it is a share, the same in both directions,
    # beside what the file has.
    share_of: str = ""
    # Last coefficients that files of earlier versions lack: zero there.
    later: tuple[str, ...] = ()

    def mirrored(self, joint: int, settings: Settings) -> "Mirrored | None":
        """Return how another joint may say the same; None if none does."""
        return None

    # ---- Further declarations: how it shows in time and frequency -------------------

    # How many times the log's low-pass is to be applied to the columns: 1 for smooth
    # terms in the filtered motion's derivatives, 2 for all that has steps or is finer
    # than the filter.
    passes: int = 2
    # Whether it shows above the cut-off as well (a ripple, the mains).
    wide: bool = False
    # Whether it shifts torque in time: the free time offset which otherwise belongs to
    # the base model must then be taken out of it.
    timing: bool = False
    # Whether it changes over minutes only, as slow noise of the measured torque does.
    slow: bool = False
    # Whether motion alone makes it show, no time, warmth or hand, so that moves can be
    # planned.
    by_motion: bool = True

    # ---- Further declarations: how it is told from the model ------------------------

    # Whether a constant effect of this kind hides in the base parameters once they are
    # free: it is then visible against earlier parameters only.
    change: bool = False
    # Whether nothing is left of it where its coefficients are right: no law of friction
    # is.
    exact: bool = False
    # Whether the grid's columns hold for small sizes only, so that gains count once
    # `sharpened`.
    first_order: bool = False
    # Whether its torque at a constant speed follows from posture and speed, so that it
    # is known what friction trials had of it.
    steady: bool = False
    # Whether a part of that is the same both ways, which gravity may have taken up.
    even: bool = False

    def shows(self, scenes: Scenes, joint: AnyJoint, settings: Settings) -> bool:
        """Return whether the logs show the effect where a model is judged.

        It is asked before a refinement adds it: below the cut-off, often enough.
        """
        return True

    # ---- Further declarations: how its settings are searched ------------------------

    def axes(self, scenes: Scenes, joint: AnyJoint) -> GridAxes:
        """Return the values of each setting that the default `grid` combines."""
        return {setting.name: setting.grid for setting in self.settings if setting.grid}

    def possible(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether it may be there though a channel to look for it is lacking."""
        return not self.available(scenes, joint)

    def between(self, settings: Settings) -> tuple[Setting, ...]:
        """Return the settings that are searched between the grid's values."""
        return tuple(setting for setting in self.settings if setting.continuous)

    def searched(self, settings: Settings) -> int:
        """Return how many parameters are searched beside the coefficients."""
        followed = sum(bool(setting.then) for setting in self.settings)
        since_a_log = settings.get(FROM_LOG, 0.0) > 0.0
        return len(self.between(settings)) + followed + since_a_log

    def beyond(self, scenes: Scenes, joint: AnyJoint) -> Grid:
        """Yield first values of settings that are not asked for."""
        return iter(())

    def size_in(self, settings: Settings) -> float | None:
        """Return the first coefficient as the settings have it; None if none has.

        Such a setting shapes the columns, and the shape tells the size as well.
        """
        return None

    def with_size(self, settings: Settings, size: float) -> dict[str, float]:
        """Return the settings where the first coefficient is of another size."""
        return dict(settings)

    def simpler(self, settings: Settings) -> dict[str, float] | None:
        """Return settings of the same effect with fewer coefficients; None if none."""
        return None

    def sharpened(self, settings: Settings, c: Array) -> dict[str, float] | None:
        """Return settings nearer to what coefficients c (k,) say; None if none.

        For columns that are exact only near the effect's true size.
        """
        sizes = [setting for setting in self.settings if setting.agreement is not None]
        nearer = {
            setting.name: float(np.clip(c[0], setting.low, setting.high))
            for setting in sizes
        }
        return nearer or None

    def reached(self, settings: Settings, *, points: int = 15) -> Grid:
        """Yield settings at which a search that starts from a grid's point may end.

        `points` of them lie in the interval of every setting that is searched.
        """
        yield dict(settings)
        for setting in self.between(settings):
            low, high = setting.bracket(settings[setting.name])
            for x in np.linspace(low, high, points):
                yield {**settings, setting.name: setting.at(float(x))}
        for setting in self.settings:
            for value in (*setting.usual, *setting.then):
                yield {**settings, setting.name: value}

    # ---- Further declarations: how it is reported -----------------------------------

    def axis(self, joint: int, settings: Settings) -> Axis | None:
        """Return the quantity that the effect is shown over at a joint.

        None where the effect makes that quantity itself.
        """
        return Axis(cast(Measure, self.over), joint) if self.over in MEASURES else None

    def waves(self, scenes: Scenes, joint: int, settings: Settings) -> float:
        """Return how many waves over a joint's travel the torque has; infinite if none.

        A few of them are as smooth a function of the position as a spring is.
        """
        return np.inf

    def lacking(self, robot: Robot, joint: AnyJoint) -> str:
        """Return why parameters do not follow from coefficients; empty if they do."""
        if not self.apart or joint is None or not rotor_hidden(robot, joint):
            return ""
        return (
            "no motion tells the rotor's inertia from the link's here, and the"
            " parameters take the link's alone: give rotor_inertia of"
            f" {robot.joint_names[joint]} in the robot file"
        )

    def reported(
        self,
        robot: Robot,
        joint: AnyJoint,
        settings: Settings,
        c: Array,
        covariance: Array,
    ) -> list[Value]:
        """Return the `values`, or none where something for them is `lacking`."""
        if self.lacking(robot, joint):
            return []
        return self.values(robot, joint, settings, c, covariance)


class FrictionEffect(Effect):
    """Friction of one joint: a torque sensor behind the gear does not see it."""

    family = "friction"
    drive = True

    def available(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether the joint moves in any log."""
        return joint is not None and moves(scenes, joint)


def knows_load(scenes: Scenes) -> bool:
    """Return whether the model knows the torques that the gears pass to their links."""
    return all(scene.model.phi is not None for scene in scenes)


def rotor_hidden(robot: Robot, joint: int) -> bool:
    """Return whether neither file nor motion tells a rotor from its link."""
    in_file = robot.joints[joint].rotor_inertia is not None
    return not in_file and f"Ia_{joint + 1}" not in free_basis(robot).names


def amplitude_and_phase(
    name: str, unit: str, c: Array, covariance: Array
) -> list[Value]:
    """Return the amplitude and phase of c_0 sin(p) + c_1 cos(p) = A sin(p + phase).

    Parameters
    ----------
    name : str
        Of the wave; the values are `name`_amplitude and `name`_phase.
    unit : str
        Of both coefficients.
    c, covariance : array
        Coefficients (2,) and their covariance (2, 2). Errors follow by the delta
        method.
    """
    amplitude = float(np.hypot(c[0], c[1]))
    phase = float(np.arctan2(c[1], c[0]))

    scale = max(amplitude, 1e-300)
    slopes = np.array([[c[0], c[1]], [-c[1] / scale, c[0] / scale]]) / scale
    variances = np.diag(slopes @ covariance @ slopes.T)
    errors = np.sqrt(np.maximum(variances, 0.0))
    return [
        Value(f"{name}_amplitude", amplitude, float(errors[0]), unit),
        Value(f"{name}_phase", phase, float(errors[1]), "rad"),
    ]
