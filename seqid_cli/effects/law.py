"""Laws of effects as formulas, which are evaluated here and written out as code.

    tau_j = sum_k c_k X_k,        X_k: a text in the grammar of `robot.formula`

A term may name the symbols of that grammar, the law's own `numbers` (settings among
them), its `parts` (sub-formulas that several terms share) and its `memories`. Laws of
the catalogue may besides name what no formula of a robot file can:

    coulomb_share   Coulomb friction at the place over its mean, 1 if not identified
    rotor           the model's rotor inertia as the joint feels it, kg m^2
    sign_width      the speed over which the direction changes, rad/s
    load_is_modelled  1, and 0 where a torque sensor behind the gear measures the load
    asin(x)         the arc sine

Where no temperature is known, a law of the temperature adds nothing.
"""

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from seqid_cli.effects.memory import Memory
from seqid_cli.effects.scene import Scene
from seqid_cli.robot.formula import FUNCTIONS, Symbol, symbol_of
from seqid_cli.typing import Array

CATALOGUE_SYMBOLS = ("coulomb_share", "rotor", "load_is_modelled", "sign_width")
_NUMBERED = re.compile(rf"({'|'.join(CATALOGUE_SYMBOLS)})(?:_([1-9][0-9]{{0,2}}))?")
CATALOGUE_FUNCTIONS = (*FUNCTIONS, "asin")

Evaluated = Array | float
Lookup = Callable[[str], Evaluated]  # the value of a name
Compiled = Callable[[Lookup], Evaluated]


def _power(base: Evaluated, exponent: Evaluated) -> Evaluated:
    """Return a power; the operator of arrays has a short way for 1, 2 and 0.5."""
    if isinstance(base, np.ndarray):
        return np.asarray(base**exponent)
    return np.asarray(np.power(base, exponent))


_NUMPY = {"min": "minimum", "max": "maximum", "asin": "arcsin"}
_CALLS: Mapping[str, Callable[..., Evaluated]] = {
    name: getattr(np, _NUMPY.get(name, name)) for name in CATALOGUE_FUNCTIONS
}
_OPERATORS: Mapping[type[ast.operator], Callable[[Evaluated, Evaluated], Evaluated]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: _power,
}


@dataclass(frozen=True, kw_only=True)
class Law:
    """The torque of one joint per unit of each coefficient, as formulas.

    Attributes
    ----------
    terms : tuple of str
        One per coefficient; "0" where a coefficient does not touch the joint.
    parts : mapping of name to str
        Sub-formulas that terms share, each of which may name those before it.
    numbers : mapping of name to float
        Settings of the effect, and what else of the robot the terms name.
    memories : mapping of name to Memory
        Quantities that do not follow from the instant alone.
    note : str
        What a reader of exported code has to know of the law.
    """

    terms: tuple[str, ...]
    parts: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)
    memories: Mapping[str, Memory] = field(default_factory=dict)
    note: str = ""

    def columns(
        self,
        scene: Scene,
        joint: int,
        shared: dict[int, dict[str, Evaluated]] | None = None,
    ) -> Array:
        """Evaluate the terms of a joint.

        Parameters
        ----------
        scene : Scene
        joint : int
        shared : dict, optional
            Parts that laws of other joints have evaluated, by the identity of `parts`;
            those of this law are added.

        Returns
        -------
        Array
            Torque (N, k) per unit coefficient, unfiltered.
        """
        evaluated: dict[str, Evaluated] = {}
        for name, memory in self.memories.items():
            evaluated[name] = memory.of_scene(scene, joint, evaluated)
        if shared is not None and id(self.parts) in shared:
            evaluated |= shared[id(self.parts)]

        lookup = self._lookup(evaluated, lambda name: quantity(scene, joint, name))
        if shared is not None and self.parts and self._parts_name_joints:
            shared[id(self.parts)] = {name: lookup(name) for name in self.parts}

        torques = [compiled(term)(lookup) for term in self.terms]
        if self._is_one_computed_array(torques):
            X = np.asarray(torques[0])[:, None]  # the usual case costs no copy
        else:
            X = np.empty((scene.samples, len(torques)))
            for k, torque in enumerate(torques):
                X[:, k] = torque

        # Where no temperature is known, the law adds nothing.
        for j in self.temperatures(joint):
            X[~np.isfinite(quantity(scene, j, "temperature"))] = 0.0
        return X

    def _is_one_computed_array(self, torques: list[Evaluated]) -> bool:
        """Return whether the only term made a new array, no quantity of the scene."""
        if len(torques) != 1:
            return False
        is_name = isinstance(tree_of(self.terms[0]), ast.Name)
        return not is_name and bool(np.ndim(torques[0]))

    def of_values(self, values: Mapping[str, Evaluated]) -> Array:
        """Evaluate the only term with values (N, ...) of the names that it has."""
        lookup = self._lookup(values, values.__getitem__)
        return np.asarray(compiled(self.terms[0])(lookup))

    @property
    def _parts_name_joints(self) -> bool:
        """True if parts are the same at every joint: their quantities name joints."""
        texts = tuple(self.parts.values())
        symbols = symbols_in(texts, frozenset({*self.numbers, *self.parts}))
        return all(symbol.joint is not None for symbol in symbols)

    @property
    def symbols(self) -> frozenset[Symbol]:
        """Quantities that terms, parts and memories take."""
        remembered = [
            text for memory in self.memories.values() for text in memory.takes
        ]
        texts = (*self.terms, *self.parts.values(), *remembered)
        own_names = {*self.numbers, *self.parts, *self.memories}
        return symbols_in(texts, frozenset(own_names))

    def temperatures(self, joint: int) -> list[int]:
        """Return the joints whose temperature the law of a joint takes."""
        return sorted(
            {
                joint if symbol.joint is None else symbol.joint
                for symbol in self.symbols
                if symbol.name == "temperature"
            }
        )

    def _lookup(self, values: Mapping[str, Evaluated], elsewhere: Lookup) -> Lookup:
        """Return a function that gives the value of a name, and remembers it.

        Names are numbers, `values`, parts, or found `elsewhere`.
        """
        value_of: dict[str, Evaluated] = {**self.numbers, **values}

        def lookup(name: str) -> Evaluated:
            if name not in value_of:
                value_of[name] = elsewhere(name)
            return value_of[name]

        for name, text in self.parts.items():
            if name not in value_of:
                value_of[name] = compiled(text)(lookup)
        return lookup


@lru_cache(maxsize=256)
def tree_of(text: str) -> ast.expr:
    """Return the tree of a term."""
    return ast.parse(text, mode="eval").body


@lru_cache(maxsize=256)
def names_in(text: str) -> frozenset[str]:
    """Return the names of a term without those of functions; `sign(dq)` names dq."""
    nodes = list(ast.walk(tree_of(text)))
    functions = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
    names = (node for node in nodes if isinstance(node, ast.Name))
    return frozenset(node.id for node in names if id(node) not in functions)


@lru_cache(maxsize=256)
def symbols_in(texts: tuple[str, ...], numbers: frozenset[str]) -> frozenset[Symbol]:
    """Return the quantities that texts name, but for names of numbers."""
    names = frozenset[str]().union(*map(names_in, texts)) - numbers
    symbols = (catalogue_symbol(name) for name in names)
    return frozenset(symbol for symbol in symbols if symbol is not None)


@lru_cache(maxsize=256)
def catalogue_symbol(name: str) -> Symbol | None:
    """Return the quantity that a name of a law stands for, None if for none."""
    match = _NUMBERED.fullmatch(name)
    if match is None:
        return symbol_of(name)
    joint = int(match[2]) - 1 if match[2] else None
    return Symbol(match[1], joint)


def direction_of(node: ast.expr) -> str | None:
    """Return the velocity whose direction a call takes: "dq" of `sign(dq)`, or None."""
    match node:
        case ast.Call(func=ast.Name(id="sign"), args=[ast.Name(id=name)]):
            symbol = symbol_of(name)
            return name if symbol is not None and symbol.name == "dq" else None
    return None


@lru_cache(maxsize=256)
def compiled(text: str) -> Compiled:
    """Return a function of the values of names that evaluates a term."""
    return _compiled(tree_of(text))


def _compiled(node: ast.expr) -> Compiled:
    """Return the function of a node.

    Terms are evaluated very often: nested closures take less time than walking a tree.
    """
    direction = direction_of(node)
    if direction is not None:
        return lambda lookup: lookup(f"sign({direction})")
    match node:
        case ast.Constant(value=value):
            number = float(value)  # type: ignore[arg-type]
            return lambda lookup: number
        case ast.Name(id=name):
            return lambda lookup: lookup(name)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            operand = _compiled(inner)
            return lambda lookup: np.negative(operand(lookup))
        case ast.UnaryOp(operand=inner):
            return _compiled(inner)
        case ast.BinOp(left=first, op=op, right=second):
            operator = _OPERATORS[type(op)]
            left = _compiled(first)
            right = _compiled(second)
            return lambda lookup: operator(left(lookup), right(lookup))
        case ast.Call(func=ast.Name(id=name), args=[inner]):
            function = _CALLS[name]
            argument = _compiled(inner)
            return lambda lookup: function(argument(lookup))
        case ast.Call(func=ast.Name(id=name), args=[first, second]):
            function = _CALLS[name]
            left = _compiled(first)
            right = _compiled(second)
            return lambda lookup: function(left(lookup), right(lookup))
    raise AssertionError(ast.dump(node))


def quantity(scene: Scene, joint: int, name: str) -> Evaluated:
    """Return a quantity (N,) of the joint, or of the one whose number ends its name."""
    if name.startswith("sign("):
        symbol = symbol_of(name[len("sign(") : -1])
        assert symbol is not None
        return scene.sign[:, joint if symbol.joint is None else symbol.joint]
    symbol = catalogue_symbol(name)
    assert symbol is not None, name
    j = joint if symbol.joint is None else symbol.joint
    match symbol.name:
        case "q" | "dq" | "ddq":
            return np.asarray(getattr(scene.motion, symbol.name)[:, j])
        case "t":
            return scene.time
        case "theta":
            return np.asarray(scene.gear[j] * scene.angle[:, j])
        case "tau":
            return scene.modelled[:, j]
        case "load" | "friction":
            return np.asarray(getattr(scene, symbol.name)[:, j])
        case "rotor":
            return float(scene.rotor[j])
        case "sign_width":
            return float(scene.sign_width[j])
        case "load_is_modelled":
            return float(scene.sensor is None)
        case "coulomb_share":
            return coulomb_share(scene, j)
    if scene.temperature is None:
        return np.full(scene.samples, np.nan)
    return scene.temperature[:, j]


PLACES = 65  # over which the mean of Coulomb friction is taken


def coulomb_share(scene: Scene, joint: int) -> Array:
    """Return Coulomb friction (N,) at the place of every sample over its mean.

    It is 1 where friction trials have not identified it.
    """
    surface = scene.model.surfaces[joint]
    q = scene.motion.q[:, joint]
    if surface is None or len(surface.speeds) == 0:
        return np.ones_like(q)
    mean = surface.mean_coulomb(PLACES)
    if mean <= 0.0:
        return np.ones_like(q)
    low, high = surface.scaling.position
    return np.asarray(surface.coulomb(np.clip(q, low, high)) / mean)


def factor_of(tree: ast.expr, coefficient: str) -> ast.expr | None:
    """Return what a coefficient is multiplied by in a formula that is linear in it.

    None where the formula does not have the coefficient.
    """
    match tree:
        case ast.Name(id=name):
            return ast.Constant(1.0) if name == coefficient else None
        case ast.UnaryOp(op=op, operand=inner):
            factor = factor_of(inner, coefficient)
            return None if factor is None else ast.UnaryOp(op, factor)
        case ast.BinOp(left=left, op=ast.Mult() as op, right=right):
            first = factor_of(left, coefficient)
            second = factor_of(right, coefficient)
            if first is None and second is None:
                return None
            return ast.BinOp(first or left, op, second or right)
        case ast.BinOp(left=left, op=ast.Div() as op, right=right):
            factor = factor_of(left, coefficient)
            return None if factor is None else ast.BinOp(factor, op, right)
        case ast.BinOp(left=left, op=(ast.Add() | ast.Sub()) as op, right=right):
            first = factor_of(left, coefficient)
            second = factor_of(right, coefficient)
            if first is not None and second is not None:
                return ast.BinOp(first, op, second)
            if second is not None and isinstance(op, ast.Sub):
                return ast.UnaryOp(ast.USub(), second)
            return first or second
    return None
