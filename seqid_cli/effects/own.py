"""Effects that a robot file adds: its own formulas, and classes of installed packages.

    tau = sum_k c_k X_k(q, dq, ddq, load, ...; settings)

Every X_k follows from the formula's text (`robot.formula`); nothing of it is ever
executed.
"""

import ast
import inspect
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Over,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law, factor_of
from seqid_cli.effects.scene import Joint, Scene, Scenes
from seqid_cli.errors import ConfigError
from seqid_cli.robot.formula import Formula
from seqid_cli.robot.types import OwnEffect, Robot

GROUP = "seqid.effects"  # of entry points
GRID = 5  # values of a setting that are tried first
STEADY = {"q", "dq", "theta", "load", "tau"}  # symbols whose values a steady motion has

_MEASURE: Mapping[str, Over] = {
    "q": "position",
    "theta": "position",
    "dq": "velocity",
    "ddq": "acceleration",
    "load": "load",
    "temperature": "temperature",
    "t": "session_time",
}


def own_effect(declared: OwnEffect, robot: Robot) -> Effect:
    """Make the effect that a robot file asks for.

    It is of the file's formula, or of an installed package.

    Raises
    ------
    ConfigError
        No package offers the effect, or it cannot be loaded.
    """
    if declared.formula is not None:
        return FormulaEffect(declared, declared.formula)

    where = str(robot.source)
    key = f"effect {declared.name!r}"
    points = {point.name: point for point in entry_points(group=GROUP)}
    if declared.name not in points:
        offered = ", ".join(sorted(points)) or "none"
        hint = f'Give torque = "c1 * ...", or install the package. Offered: {offered}.'
        message = f"{key} has no formula, and no installed package offers it"
        raise ConfigError(message, where=where, hint=hint)

    point = points[declared.name]
    try:
        loaded = point.load()
        effect = loaded() if inspect.isclass(loaded) else loaded
    except Exception as problem:  # whatever a package of somebody else's raises
        reason = f"{type(problem).__name__}: {problem}"
        message = f"{key} cannot be loaded from {point.value}: {reason}"
        raise ConfigError(message, where=where) from None

    if not isinstance(effect, Effect) or effect.name != declared.name:
        hint = (
            "It must be a subclass of seqid_cli.effects.effect.Effect with this name."
        )
        message = f"{key}: {point.value} is no effect of that name"
        raise ConfigError(message, where=where, hint=hint)
    return effect


class FormulaEffect(Effect):
    """An effect by a formula of the robot file."""

    def __init__(self, declared: OwnEffect, formula: Formula) -> None:
        self.name = declared.name
        self.formula = formula
        self.__doc__ = f"{formula.text}, of the robot file."

        names = {symbol.name for symbol in formula.symbols}
        calls = (node for node in ast.walk(formula.tree) if isinstance(node, ast.Call))
        self.sided = any(ast.unparse(call) == "sign(dq)" for call in calls)
        self.family = "friction" if self.sided else "transmission"
        self.steady = self.sided and names <= STEADY

        # It is shown over the one quantity of its own joint that it depends on beside
        # the direction, if there is one.
        quantities = names - {"dq"} or names
        of_own_joint = all(symbol.joint is None for symbol in formula.symbols)
        if len(quantities) == 1 and of_own_joint:
            (quantity,) = quantities
            self.over = _MEASURE.get(quantity, "torque")

        self.settings = tuple(
            Setting(name, "", low=low, high=high, logarithmic=low > 0.0)
            for name, (low, high) in declared.settings.items()
        )
        self.separate_by = (
            f"motions in which {', '.join(sorted(names)) or 'nothing else'} change"
            " apart from each other, over all of their range"
        )
        self._names = names

    def local(self, settings: Settings) -> bool:
        """Return whether it needs neither the session's clock nor the temperature."""
        return not self._names & {"t", "temperature"}

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Return whether the logs have the channels that the formula names."""
        if joint is None:
            return False
        is_logged = all(scene.temperature is not None for scene in scenes)
        return is_logged or "temperature" not in self._names

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the formula's coefficients; their units follow from its terms."""
        return tuple(Coefficient(name, "SI") for name in self.formula.coefficients)

    def axes(self, scenes: Scenes, joint: Joint) -> Mapping[str, Sequence[float]]:
        """Return values between the limits of each setting, evenly or by ratio."""
        axes = {}
        for setting in self.settings:
            spaced = np.geomspace if setting.logarithmic else np.linspace
            axes[setting.name] = spaced(setting.low, setting.high, GRID).tolist()
        return axes

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the factor of each of the formula's coefficients."""
        factors = [factor_of(self.formula.tree, c) for c in self.formula.coefficients]
        terms = tuple(ast.unparse(factor) for factor in factors if factor is not None)
        return {joint: Law(terms=terms, numbers=settings)}

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Evaluate every term.

        Raises
        ------
        ConfigError
            A term is no finite number at some sample.
        """
        law = self.laws(scene.robot, joint, settings)[joint]
        with np.errstate(all="ignore"):
            X = law.columns(scene, joint)
        n_bad = len(X) - int(np.isfinite(X).all(axis=1).sum())
        if not n_bad:
            return {joint: X}

        message = (
            f"effect {self.name!r}: {self.formula.text!r} is no finite number at"
            f" {scene.robot.joint_names[joint]} for {n_bad} of {len(X)} samples"
        )
        hint = (
            "Keep divisors and arguments of log and sqrt away from zero, as in abs(dq)"
            " + 0.01."
        )
        raise ConfigError(message, where=str(scene.robot.source), hint=hint)
