"""Effects of one's own: formulas of the robot file, and those of installed packages.

    tau = sum_k c_k X_k(q, dq, ddq, load, ...; settings)

Every X_k follows from the formula's text (`robot.formula`); nothing of it is ever executed.
"""

import ast
import inspect
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Over, Setting, Settings
from seqid_cli.model.effects.scene import Joint, Scene, Scenes
from seqid_cli.robot.formula import Formula, Symbol, is_coefficient, symbol_of
from seqid_cli.robot.types import OwnEffect, Robot
from seqid_cli.typing import Array

GROUP = "seqid.effects"  # of entry points
GRID = 5  # values of a setting that are tried first

_MEASURE: Mapping[str, Over] = {
    "q": "position",
    "theta": "position",
    "dq": "velocity",
    "ddq": "acceleration",
    "load": "load",
    "temperature": "temperature",
    "t": "session_time",
}
_FUNCTIONS = {
    "abs": np.abs,
    "sign": np.sign,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "tanh": np.tanh,
    "min": np.minimum,
    "max": np.maximum,
}


def own_effect(asked: OwnEffect, robot: Robot) -> Effect:
    """Make an effect of what a robot file asks for.

    Raises
    ------
    ConfigError
        If no installed package offers an effect that has no formula, or it cannot be loaded.
    """
    if asked.formula is not None:
        return FormulaEffect(asked, asked.formula)
    return _of_package(asked.name, robot)


def _of_package(name: str, robot: Robot) -> Effect:
    where, key = str(robot.source), f"effect {name!r}"
    found = list(entry_points(group=GROUP, name=name))
    if not found:
        offered = ", ".join(sorted({point.name for point in entry_points(group=GROUP)})) or "none"
        raise ConfigError(
            f"{key} has no formula, and no installed package offers it",
            where=where,
            hint=f'Give torque = "c1 * ...", or install the package. Offered: {offered}.',
        )
    try:
        made = found[0].load()
        effect = made() if inspect.isclass(made) else made
    except Exception as problem:  # whatever a package of somebody else's raises
        text = f"{type(problem).__name__}: {problem}"
        raise ConfigError(
            f"{key} cannot be loaded from {found[0].value}: {text}", where=where
        ) from None
    if not isinstance(effect, Effect) or effect.name != name:
        raise ConfigError(
            f"{key}: {found[0].value} is no effect of that name",
            where=where,
            hint="It must be a subclass of seqid_cli.model.effects.effect.Effect with this name.",
        )
    return effect


class FormulaEffect(Effect):
    """What a formula of the robot file says."""

    def __init__(self, asked: OwnEffect, formula: Formula) -> None:
        self.name, self.formula = asked.name, formula
        self.__doc__ = f"{formula.text}, of the robot file."
        names = {symbol.name for symbol in formula.symbols}
        self.sided = _turns(formula.tree)
        self.family = "friction" if self.sided else "transmission"
        self.over = _shown_over(formula.symbols)
        self.settings = tuple(
            Setting(name, "", low=low, high=high, logarithmic=low > 0.0)
            for name, (low, high) in asked.settings.items()
        )
        self.separate_by = (
            f"motions in which {', '.join(sorted(names)) or 'nothing else'} change apart from each "
            "other, over all of their range"
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
            s.name: (np.geomspace if s.logarithmic else np.linspace)(s.low, s.high, GRID).tolist()
            for s in self.settings
        }

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Evaluate every term.

        Raises
        ------
        ConfigError
            If a term is no finite number somewhere.
        """
        assert joint is not None
        with np.errstate(all="ignore"):
            terms = _Terms(scene, joint, settings).of(self.formula.tree)
        X = np.column_stack(
            [np.broadcast_to(terms[name], scene.samples) for name in self.formula.coefficients]
        ).astype(np.float64)
        bad = ~np.isfinite(X).all(axis=1)
        if bad.any():
            raise ConfigError(
                f"effect {self.name!r}: {self.formula.text!r} is no finite number at "
                f"{scene.robot.joint_names[joint]} for {int(bad.sum())} of {len(X)} samples",
                where=str(scene.robot.source),
                hint="Keep divisors and arguments of log and sqrt away from zero, as in "
                "abs(dq) + 0.01.",
            )
        return {joint: X}


_Value = dict[str, Array]  # factors of coefficients, or of "" for what has none


class _Terms:
    """Evaluates a tree that was checked, as factors of the coefficients."""

    def __init__(self, scene: Scene, joint: int, settings: Settings) -> None:
        self.scene, self.joint, self.settings = scene, joint, settings

    def of(self, node: ast.expr) -> _Value:
        match node:
            case ast.Constant(value=value):
                return {"": np.asarray(float(value))}  # type: ignore[arg-type]
            case ast.Name(id=name):
                return {name: np.ones(())} if is_coefficient(name) else {"": self._known(name)}
            case ast.UnaryOp(op=op, operand=inner):
                sign = -1.0 if isinstance(op, ast.USub) else 1.0
                return {name: sign * x for name, x in self.of(inner).items()}
            case ast.BinOp(left=left, op=op, right=right):
                return _joined(op, self.of(left), self.of(right))
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return {"": self._called(name, arguments)}
        raise AssertionError(ast.dump(node))

    def _called(self, name: str, arguments: list[ast.expr]) -> Array:
        symbol = symbol_of(arguments[0].id) if isinstance(arguments[0], ast.Name) else None
        if name == "sign" and symbol is not None and symbol.name == "dq":
            return self.scene.sign[:, self._joint(symbol)]
        return np.asarray(_FUNCTIONS[name](*(self.of(argument)[""] for argument in arguments)))

    def _known(self, name: str) -> Array:
        if name in self.settings:
            return np.asarray(self.settings[name])
        symbol = symbol_of(name)
        assert symbol is not None
        return _quantity(self.scene, symbol.name, self._joint(symbol))

    def _joint(self, symbol: Symbol) -> int:
        return self.joint if symbol.joint is None else symbol.joint


def _joined(op: ast.operator, left: _Value, right: _Value) -> _Value:
    match op:
        case ast.Add() | ast.Sub():
            turned = right if isinstance(op, ast.Add) else {k: -x for k, x in right.items()}
            names = left.keys() | turned.keys()
            return {k: left.get(k, np.zeros(())) + turned.get(k, np.zeros(())) for k in names}
        case ast.Mult():
            factors, plain = (left, right) if "" in right else (right, left)
            return {k: x * plain[""] for k, x in factors.items()}
        case ast.Div():
            return {k: x / right[""] for k, x in left.items()}
    return {"": np.asarray(left[""] ** right[""])}


def _quantity(scene: Scene, name: str, joint: int) -> Array:
    """One quantity (N,) of a joint."""
    if name == "t":
        return scene.time
    if name == "theta":
        return np.asarray(scene.gear[joint] * scene.angle[:, joint])
    if name == "temperature":
        assert scene.temperature is not None
        return scene.temperature[:, joint]
    if name in {"q", "dq", "ddq"}:
        return np.asarray(getattr(scene.motion, name)[:, joint])
    return np.asarray(
        {"tau": scene.modelled, "load": scene.load}.get(name, scene.friction)[:, joint]
    )


def _turns(tree: ast.expr) -> bool:
    """Whether a formula takes the direction of motion."""
    return any(
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "sign"
        and isinstance(node.args[0], ast.Name)
        and node.args[0].id == "dq"
        for node in ast.walk(tree)
    )


def _shown_over(symbols: frozenset[Symbol]) -> Over:
    """The one quantity of its own joint that it depends on beside the direction, if it is one."""
    names = {symbol.name for symbol in symbols}
    some = names - {"dq"} or names
    alone = len(some) == 1 and all(symbol.joint is None for symbol in symbols)
    return _MEASURE.get(next(iter(some)), "torque") if alone else "torque"
