"""Effects with numbers in them: how they stand in a parameter file, and back."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.registry import catalogue_of
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.model.effects.smooth import SmoothTerm, damaged
from seqid_cli.model.effects.units import UNEXPLAINED
from seqid_cli.params.schema import EffectOfJoint, EffectSession, Parameter, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True)
class FittedEffect:
    """An effect of the catalogue at a joint (None: of the whole arm, or of all joints alike).

    `coefficients` (k,) and `covariance` (k, k) belong to the columns; `session` says
    which logs the effect's times and log numbers are of.
    """

    effect: Effect
    joint: Joint
    settings: Mapping[str, float]
    coefficients: Array
    covariance: Array
    session: EffectSession | None = None

    @property
    def passes(self) -> int:
        """How many times the low-pass is to be applied."""
        return self.effect.passes

    @property
    def local(self) -> bool:
        """Whether its torque at a moment follows from the motion around it."""
        return self.effect.local(self.settings)

    def torques(self, scene: Scene) -> dict[int, Array]:
        """Torque (N,) N m of every joint that is touched, unfiltered."""
        columns = self.effect.columns(scene, self.joint, self.settings)
        return {j: X @ self.coefficients for j, X in columns.items()}


Fitted = FittedEffect | SmoothTerm


def fitted_effects(
    stages: Stages, robot: Robot, *, unexplained: bool = False
) -> list[Fitted]:
    """Restore the effects of a parameter file; smooth terms only where `unexplained` are wanted.

    Raises ConfigError if an effect is not known, or its joint, settings or coefficients
    are not what it takes; the message names the key.
    """
    found: list[Fitted] = []
    catalogue = catalogue_of(robot) if stages.effects else {}
    for index, entry in enumerate(stages.effects or []):
        key = f"$.stages.effects[{index}]"
        if entry.effect != UNEXPLAINED:
            found.append(_restored(key, entry, robot, catalogue))
        elif unexplained:
            found.append(SmoothTerm.from_stage(entry, robot, key))
    return found


def as_stage(fitted: FittedEffect, robot: Robot) -> EffectOfJoint:
    """Write an effect down; `fitted_effects` restores it exactly."""
    effect, settings, joint = (
        fitted.effect,
        fitted.settings,
        robot.name_of(fitted.joint),
    )
    c, covariance = fitted.coefficients, fitted.covariance
    physical = effect.reported(robot, fitted.joint, settings, c, covariance)
    return EffectOfJoint(
        effect=effect.name,
        joint=joint,
        parameters=[Parameter(**vars(value), joint=joint or "") for value in physical],
        settings={name: float(value) for name, value in settings.items()},
        coefficients=c.tolist(),
        covariance=covariance.tolist(),
        session=fitted.session,
    )


def _restored(
    key: str, entry: EffectOfJoint, robot: Robot, catalogue: Mapping[str, Effect]
) -> FittedEffect:
    effect = catalogue.get(entry.effect)
    if effect is None:
        message = (
            f"{key}.effect: no effect named {entry.effect!r} is known to this version"
        )
        hint = (
            f"An effect of your own must stand in {robot.source.name} as [[effect]]; a"
            " newer "
        )
        hint += "seqid may have written the file: update, or take the effect out of it."
        raise ConfigError(message, hint=hint)
    settings = _settings(key, effect, entry)
    coefficients = _coefficients(key, effect, entry, settings)
    count = len(coefficients)
    covariance = (
        np.array(entry.covariance) if entry.covariance else np.zeros((count, count))
    )
    if covariance.shape != (count, count):
        raise damaged(f"{key}.covariance", f"must have {count} rows of {count} numbers")
    more = len(effect.coefficients(settings)) - count
    coefficients, covariance = (
        np.pad(coefficients, (0, more)),
        np.pad(covariance, (0, more)),
    )
    joint = _joint(key, effect, entry, robot)
    return FittedEffect(
        effect, joint, settings, coefficients, covariance, entry.session
    )


def _joint(key: str, effect: Effect, entry: EffectOfJoint, robot: Robot) -> int | None:
    if entry.joint is None:
        if not (effect.arm or effect.shared):
            raise damaged(
                f"{key}.joint", f"{effect.name} is an effect of one joint: name it"
            )
        return None
    if effect.arm:
        raise damaged(
            f"{key}.joint", f"{effect.name} is of the whole arm: must be null"
        )
    if entry.joint not in robot.joint_names:
        known = ", ".join(robot.joint_names)
        raise damaged(
            f"{key}.joint", f"{entry.joint!r} is none of the robot's joints: {known}"
        )
    return robot.joint_names.index(entry.joint)


def _settings(key: str, effect: Effect, entry: EffectOfJoint) -> dict[str, float]:
    known = [setting.name for setting in effect.settings]
    for name in entry.settings:
        if name not in known:
            takes = ", ".join(known) or "none"
            raise damaged(f"{key}.settings.{name}", f"{effect.name} takes {takes}")
    found = {}
    for setting in effect.settings:
        value, where = (
            entry.settings.get(setting.name),
            f"{key}.settings.{setting.name}",
        )
        if value is None and not setting.asked:
            continue
        if value is None:
            raise damaged(where, f"is missing, and {effect.name} needs it")
        if isinstance(value, str | bool) or not np.isfinite(value):
            raise damaged(where, f"must be a number, is {value!r}")
        if not setting.low <= value <= setting.high:
            limits = f"{setting.low:g} to {setting.high:g}"
            raise damaged(where, f"must lie within {limits}, is {value!r}")
        found[setting.name] = float(value)
    return found


def _coefficients(
    key: str, effect: Effect, entry: EffectOfJoint, settings: Mapping[str, float]
) -> Array:
    """Coefficients as written, or the parameters of their names; late ones may be missing."""
    names = [spec.name for spec in effect.coefficients(settings)]
    early = [name for name in names if name not in effect.later]
    if len(entry.coefficients or entry.parameters) == len(early):
        names = early
    if entry.coefficients:
        if len(entry.coefficients) != len(names):
            count = f"{len(names)} numbers, has {len(entry.coefficients)}"
            raise damaged(f"{key}.coefficients", f"{effect.name} takes {count}")
        return np.array(entry.coefficients, dtype=float)
    values = {parameter.name: parameter.value for parameter in entry.parameters}
    missing = [name for name in names if name not in values]
    if missing:
        raise damaged(
            f"{key}.coefficients", f"{effect.name} lacks {', '.join(missing)}"
        )
    return np.array([values[name] for name in names], dtype=float)


def effect_notes(stages: Stages, *, unexplained: bool = False) -> list[str]:
    """Say which effects of a parameter file take part in a prediction, and what is left out."""
    notes, entries = [], stages.effects or []
    taken = [entry for entry in entries if unexplained or entry.effect != UNEXPLAINED]
    if taken:
        named = ", ".join(
            f"{entry.effect} ({entry.joint or 'all joints'})" for entry in taken
        )
        notes.append(f"effects in the prediction: {named}")
    smooth = [entry.joint or "" for entry in entries if entry.effect == UNEXPLAINED]
    if smooth and not unexplained:
        left = (
            "a smooth term of no known cause is left out (--with-unexplained takes"
            " it in)"
        )
        notes.append(f"{left}: {', '.join(smooth)}")
    return notes
