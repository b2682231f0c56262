"""Effects of one's own: formulas of the robot file, and those of installed packages.

    tau = sum_k c_k X_k(q, dq, ddq, load, ...; settings)

Every X_k follows from the formula's text (`robot.formula`); nothing of it is ever
executed.
"""

import ast
import inspect
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Over,
    Setting,
    Settings,
)
from seqid_cli.model.effects.law import Law, factor_of
from seqid_cli.model.effects.scene import Joint, Scene, Scenes
from seqid_cli.robot.formula import Formula
from seqid_cli.robot.types import OwnEffect, Robot

GROUP = "seqid.effects"  # of entry points
GRID = 5  # values of a setting that are tried first
STEADY = {"q", "dq", "theta", "load", "tau"}  # what steady motion tells

_MEASURE: Mapping[str, Over] = {
    "q": "position",
    "theta": "position",
    "dq": "velocity",
    "ddq": "acceleration",
    "load": "load",
    "temperature": "temperature",
    "t": "session_time",
}


def own_effect(asked: OwnEffect, robot: Robot) -> Effect:
    """Make an effect of what a robot file asks for: by its formula, or of an installed package.

    Raises ConfigError if no package offers it, or it cannot be loaded.
    """
    if asked.formula is not None:
        return FormulaEffect(asked, asked.formula)
    name, where, key = asked.name, str(robot.source), f"effect {asked.name!r}"
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        offered = ", ".join(sorted(points)) or "none"
        hint = f'Give torque = "c1 * ...", or install the package. Offered: {offered}.'
        message = f"{key} has no formula, and no installed package offers it"
        raise ConfigError(message, where=where, hint=hint)
    source = points[name].value
    try:
        made = points[name].load()
        effect = made() if inspect.isclass(made) else made
    except Exception as problem:  # whatever a package of somebody else's raises
        text = f"{type(problem).__name__}: {problem}"
        raise ConfigError(
            f"{key} cannot be loaded from {source}: {text}", where=where
        ) from None
    if not isinstance(effect, Effect) or effect.name != name:
        hint = (
            "It must be a subclass of seqid_cli.model.effects.effect.Effect with this"
            " name."
        )
        raise ConfigError(
            f"{key}: {source} is no effect of that name", where=where, hint=hint
        )
    return effect


class FormulaEffect(Effect):
    """What a formula of the robot file says."""

    def __init__(self, asked: OwnEffect, formula: Formula) -> None:
        self.name, self.formula = asked.name, formula
        self.__doc__ = f"{formula.text}, of the robot file."
        names = {symbol.name for symbol in formula.symbols}
        calls = (node for node in ast.walk(formula.tree) if isinstance(node, ast.Call))
        self.sided = any(ast.unparse(call) == "sign(dq)" for call in calls)
        self.family = "friction" if self.sided else "transmission"
        # Over the one quantity of its own joint that it depends on beside the
        # direction.
        some = names - {"dq"} or names
        alone = len(some) == 1 and all(
            symbol.joint is None for symbol in formula.symbols
        )
        self.over = _MEASURE.get(next(iter(some)), "torque") if alone else "torque"
        self.steady = self.sided and names <= STEADY
        self.settings = tuple(
            Setting(name, "", low=low, high=high, logarithmic=low > 0.0)
            for name, (low, high) in asked.settings.items()
        )
        self.separate_by = (
            f"motions in which {', '.join(sorted(names)) or 'nothing else'} change"
            " apart from each other, over all of their range"
        )
        self._names = names

    def local(self, settings: Settings) -> bool:
        """Not where it needs the session's clock or the temperature."""
        return not self._names & {"t", "temperature"}

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Ask for the channels and the model that it names."""
        warm = all(scene.temperature is not None for scene in scenes)
        return joint is not None and (warm or "temperature" not in self._names)

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the formula's own; their units follow from its terms."""
        return tuple(Coefficient(name, "SI") for name in self.formula.coefficients)

    def axes(self, scenes: Scenes, joint: Joint) -> Mapping[str, Sequence[float]]:
        """Values between the limits of each setting, evenly or by ratio."""
        return {
            s.name: (
                (np.geomspace if s.logarithmic else np.linspace)(
                    s.low, s.high, GRID
                ).tolist()
            )
            for s in self.settings
        }

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return what the formula has beside each of its coefficients."""
        factors = [factor_of(self.formula.tree, c) for c in self.formula.coefficients]
        terms = tuple(ast.unparse(factor) for factor in factors if factor is not None)
        return {joint: Law(terms=terms, numbers=settings)}

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Evaluate every term; raises ConfigError where one is no finite number."""
        with np.errstate(all="ignore"):
            X = self.laws(scene.robot, joint, settings)[joint].columns(scene, joint)
        bad = len(X) - int(np.isfinite(X).all(axis=1).sum())
        if not bad:
            return {joint: X}
        many = f"{scene.robot.joint_names[joint]} for {bad} of {len(X)} samples"
        message = (
            f"effect {self.name!r}: {self.formula.text!r} is no finite number at {many}"
        )
        hint = (
            "Keep divisors and arguments of log and sqrt away from zero, as in abs(dq)"
            " + 0.01."
        )
        raise ConfigError(message, where=str(scene.robot.source), hint=hint)
