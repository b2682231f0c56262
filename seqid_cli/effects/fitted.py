"""Effects with numbers in them: how they stand in a parameter file, and back."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seqid_cli.effects.effect import Effect
from seqid_cli.effects.registry import catalogue_of
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.effects.smooth import SmoothTerm, damaged
from seqid_cli.effects.units import UNEXPLAINED
from seqid_cli.errors import ConfigError
from seqid_cli.params.schema import EffectOfJoint, EffectSession, Parameter, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class FittedEffect:
    """An effect of the catalogue at a joint, with its numbers.

    Attributes
    ----------
    effect : Effect
    joint : int or None
        None for the whole arm, or all joints alike.
    settings : mapping of str to float
    coefficients, covariance : Array
        (k,) and (k, k), of the effect's columns.
    session : EffectSession, optional
        The logs that the effect's times and log numbers are of.
    late : bool
        Whether it came after friction, gravity and inertia were identified: their logs
        do not have it.
    """

    effect: Effect
    joint: Joint
    settings: Mapping[str, float]
    coefficients: Array
    covariance: Array
    session: EffectSession | None = None
    late: bool = False

    @property
    def passes(self) -> int:
        """Number of times that the low-pass is to be applied."""
        return self.effect.passes

    @property
    def local(self) -> bool:
        """True if its torque at a moment follows from the motion around it."""
        return self.effect.local(self.settings)

    def torques(self, scene: Scene) -> dict[int, Array]:
        """Compute the torque (N,) N m of every joint that is touched, unfiltered."""
        columns = self.effect.columns_in_log(scene, self.joint, self.settings)
        return {j: X @ self.coefficients for j, X in columns.items()}


Fitted = FittedEffect | SmoothTerm


def fitted_effects(
    stages: Stages, robot: Robot, *, unexplained: bool = False
) -> list[Fitted]:
    """Restore the effects of a parameter file.

    Parameters
    ----------
    stages : Stages
    robot : Robot
    unexplained : bool
        Whether smooth terms are wanted as well.

    Returns
    -------
    list of FittedEffect or SmoothTerm

    Raises
    ------
    ConfigError
        An effect is not known, or its joint, settings or coefficients are not what it
        takes; the message names the key.
    """
    fitted: list[Fitted] = []
    catalogue = catalogue_of(robot) if stages.effects else {}
    for index, entry in enumerate(stages.effects or []):
        key = f"$.stages.effects[{index}]"
        if entry.effect != UNEXPLAINED:
            fitted.append(_restored(key, entry, robot, catalogue))
        elif unexplained:
            fitted.append(SmoothTerm.from_stage(entry, robot, key))
    return fitted


def as_stage(fitted: FittedEffect, robot: Robot) -> EffectOfJoint:
    """Write an effect down; `fitted_effects` restores it exactly."""
    joint = robot.name_of(fitted.joint)
    values = fitted.effect.reported(
        robot, fitted.joint, fitted.settings, fitted.coefficients, fitted.covariance
    )
    return EffectOfJoint(
        effect=fitted.effect.name,
        joint=joint,
        parameters=[Parameter(**vars(value), joint=joint or "") for value in values],
        settings={name: float(value) for name, value in fitted.settings.items()},
        coefficients=fitted.coefficients.tolist(),
        covariance=fitted.covariance.tolist(),
        session=fitted.session,
        late=fitted.late,
    )


def _restored(
    key: str, entry: EffectOfJoint, robot: Robot, catalogue: Mapping[str, Effect]
) -> FittedEffect:
    """Restore the effect that stands under `key` in a parameter file."""
    effect = catalogue.get(entry.effect)
    if effect is None:
        message = (
            f"{key}.effect: no effect named {entry.effect!r} is known to this version"
        )
        hint = (
            f"An effect of your own must stand in {robot.source.name} as [[effect]]; a"
            " newer seqid may have written the file: update, or take the effect out of"
            " it."
        )
        raise ConfigError(message, hint=hint)

    settings = _settings(key, effect, entry)
    coefficients = _coefficients(key, effect, entry, settings)
    count = len(coefficients)
    covariance = np.zeros((count, count))
    if entry.covariance:
        covariance = np.array(entry.covariance)
    if covariance.shape != (count, count):
        raise damaged(f"{key}.covariance", f"must have {count} rows of {count} numbers")

    # Coefficients that files of earlier versions lack are zero.
    n_lacking = len(effect.coefficients(settings)) - count
    return FittedEffect(
        effect=effect,
        joint=_joint(key, effect, entry, robot),
        settings=settings,
        coefficients=np.pad(coefficients, (0, n_lacking)),
        covariance=np.pad(covariance, (0, n_lacking)),
        session=entry.session,
        late=entry.late,
    )


def _joint(key: str, effect: Effect, entry: EffectOfJoint, robot: Robot) -> int | None:
    """Return the index of an entry's joint; None for the whole arm or all joints."""
    key = f"{key}.joint"
    if entry.joint is None:
        if effect.arm or effect.shared:
            return None
        raise damaged(key, f"{effect.name} is an effect of one joint: name it")
    if effect.arm:
        raise damaged(key, f"{effect.name} is of the whole arm: must be null")
    if entry.joint not in robot.joint_names:
        names = ", ".join(robot.joint_names)
        raise damaged(key, f"{entry.joint!r} is none of the robot's joints: {names}")
    return robot.joint_names.index(entry.joint)


def _settings(key: str, effect: Effect, entry: EffectOfJoint) -> dict[str, float]:
    """Return an entry's settings, all of them within the effect's limits."""
    allowed = [setting.name for setting in effect.settings]
    for name in entry.settings:
        if name not in allowed:
            takes = ", ".join(allowed) or "none"
            raise damaged(f"{key}.settings.{name}", f"{effect.name} takes {takes}")

    values = {}
    for setting in effect.settings:
        value = entry.settings.get(setting.name)
        where = f"{key}.settings.{setting.name}"
        if value is None:
            if setting.asked:
                raise damaged(where, f"is missing, and {effect.name} needs it")
            continue
        if isinstance(value, str | bool) or not np.isfinite(value):
            raise damaged(where, f"must be a number, is {value!r}")
        if not setting.low <= value <= setting.high:
            limits = f"{setting.low:g} to {setting.high:g}"
            raise damaged(where, f"must lie within {limits}, is {value!r}")
        values[setting.name] = float(value)
    return values


def _coefficients(
    key: str, effect: Effect, entry: EffectOfJoint, settings: Mapping[str, float]
) -> Array:
    """Return an entry's coefficients, or else its parameters of the same names.

    The `later` ones of the effect may be missing.
    """
    names = [spec.name for spec in effect.coefficients(settings)]
    earlier_names = [name for name in names if name not in effect.later]
    if len(entry.coefficients or entry.parameters) == len(earlier_names):
        names = earlier_names

    if entry.coefficients:
        if len(entry.coefficients) != len(names):
            count = f"{len(names)} numbers, has {len(entry.coefficients)}"
            raise damaged(f"{key}.coefficients", f"{effect.name} takes {count}")
        return np.array(entry.coefficients, dtype=float)

    values = {parameter.name: parameter.value for parameter in entry.parameters}
    missing = [name for name in names if name not in values]
    if missing:
        problem = f"{effect.name} lacks {', '.join(missing)}"
        raise damaged(f"{key}.coefficients", problem)
    return np.array([values[name] for name in names], dtype=float)


def effect_notes(stages: Stages, *, unexplained: bool = False) -> list[str]:
    """Say which effects of a file take part in a prediction, and which do not."""
    entries = stages.effects or []
    notes = []
    taken = [entry for entry in entries if unexplained or entry.effect != UNEXPLAINED]
    if taken:
        named = ", ".join(
            f"{entry.effect} ({entry.joint or 'all joints'})" for entry in taken
        )
        notes.append(f"effects in the prediction: {named}")

    smooth = [entry.joint or "" for entry in entries if entry.effect == UNEXPLAINED]
    if smooth and not unexplained:
        notes.append(
            "a smooth term of no known cause is left out (--with-unexplained takes it"
            f" in): {', '.join(smooth)}"
        )
    return notes
