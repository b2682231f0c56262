"""Laws of effects, written once: as formulas that are evaluated here and written out as code.

    tau_j = sum_k c_k X_k,        X_k: a text in the grammar of `robot.formula`

A term may name the symbols of that grammar, the law's own `numbers` (settings among
them), its `parts` (sub-formulas that several terms share) and its `memories`. Laws of
the catalogue may besides name what no formula of a robot file can:

    coulomb_share   Coulomb friction at the place over its mean, 1 where none is identified
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

from seqid_cli.model.effects.memory import Memory
from seqid_cli.model.effects.scene import Scene
from seqid_cli.robot.formula import FUNCTIONS, Symbol, symbol_of
from seqid_cli.typing import Array

CATALOGUE_SYMBOLS = ("coulomb_share", "rotor", "load_is_modelled", "sign_width")
_NUMBERED = re.compile(rf"({'|'.join(CATALOGUE_SYMBOLS)})(?:_([1-9][0-9]{{0,2}}))?")
CATALOGUE_FUNCTIONS = (*FUNCTIONS, "asin")

Evaluated = Array | float
Lookup = Callable[[str], Evaluated]  # the value of a name
Compiled = Callable[[Lookup], Evaluated]


def _power(base: Evaluated, exponent: Evaluated) -> Evaluated:
    """Raise to a power; the operator of arrays has a short way for 1, 2 and 0.5."""
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
        What a reader of exported code has to know of it.
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
        """Evaluate the terms of a joint: torque (N, k) per unit coefficient, unfiltered.

        `shared` holds parts that laws of other joints have evaluated, by the parts'
        identity.
        """
        remembered: dict[str, Evaluated] = {}
        for name, memory in self.memories.items():
            remembered[name] = memory.of_scene(scene, joint, remembered)
        if shared is not None and id(self.parts) in shared:
            remembered |= shared[id(self.parts)]
        names = self._lookup(remembered, lambda name: quantity(scene, joint, name))
        if shared is not None and self.parts and self._parts_name_joints:
            shared[id(self.parts)] = {name: names(name) for name in self.parts}

        torques = [compiled(term)(names) for term in self.terms]
        computed = (
            not isinstance(tree_of(self.terms[0]), ast.Name) if self.terms else False
        )
        if len(torques) == 1 and computed and np.ndim(torques[0]):
            X = np.asarray(torques[0])[:, None]  # the usual case costs no copy
        else:
            X = np.empty((scene.samples, len(torques)))
            for k, torque in enumerate(torques):
                X[:, k] = torque
        for j in self.temperatures(joint):
            X[~np.isfinite(quantity(scene, j, "temperature"))] = 0.0
        return X

    def of_values(self, values: Mapping[str, Evaluated]) -> Array:
        """Evaluate the only term with values (N, ...) of the names that it has."""
        names = self._lookup(values, values.__getitem__)
        return np.asarray(compiled(self.terms[0])(names))

    @property
    def _parts_name_joints(self) -> bool:
        """Whether parts are the same at every joint: their quantities are of named joints."""
        taken = symbols_in(
            tuple(self.parts.values()), frozenset({*self.numbers, *self.parts})
        )
        return all(symbol.joint is not None for symbol in taken)

    @property
    def symbols(self) -> frozenset[Symbol]:
        """Quantities that terms, parts and memories take."""
        taken = [text for memory in self.memories.values() for text in memory.takes]
        texts = (*self.terms, *self.parts.values(), *taken)
        named = {*self.numbers, *self.parts, *self.memories}
        return symbols_in(texts, frozenset(named))

    def temperatures(self, joint: int) -> list[int]:
        """Return the joints whose temperature the law of a joint takes."""
        warm = (symbol for symbol in self.symbols if symbol.name == "temperature")
        return sorted({joint if s.joint is None else s.joint for s in warm})

    def _lookup(self, values: Mapping[str, Evaluated], elsewhere: Lookup) -> Lookup:
        known: dict[str, Evaluated] = {**self.numbers, **values}

        def lookup(name: str) -> Evaluated:
            if name not in known:
                known[name] = elsewhere(name)
            return known[name]

        for name, text in self.parts.items():
            if name not in known:
                known[name] = compiled(text)(lookup)
        return lookup


@lru_cache(maxsize=256)
def tree_of(text: str) -> ast.expr:
    """Return the tree of a term."""
    return ast.parse(text, mode="eval").body


@lru_cache(maxsize=256)
def names_in(text: str) -> frozenset[str]:
    """Return the names of a term, those of functions left out; `sign(dq)` names dq."""
    tree = tree_of(text)
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    return frozenset(node.id for node in nodes if id(node) not in called)


@lru_cache(maxsize=256)
def symbols_in(texts: tuple[str, ...], numbers: frozenset[str]) -> frozenset[Symbol]:
    """Return the quantities that texts name, but for names of numbers."""
    names = frozenset[str]().union(*map(names_in, texts)) - numbers
    found = (catalogue_symbol(name) for name in names)
    return frozenset(symbol for symbol in found if symbol is not None)


@lru_cache(maxsize=256)
def catalogue_symbol(name: str) -> Symbol | None:
    """Return the quantity that a name of a law stands for, None if for none."""
    match = _NUMBERED.fullmatch(name)
    if match is None:
        return symbol_of(name)
    return Symbol(match[1], int(match[2]) - 1 if match[2] else None)


def direction_of(node: ast.expr) -> str | None:
    """Return the velocity whose direction a call takes: "dq" of `sign(dq)`, else None."""
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
    """Return the function of a node; nested closures cost discovery less than walking trees."""
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
            operator, left, right = (
                _OPERATORS[type(op)],
                _compiled(first),
                _compiled(second),
            )
            return lambda lookup: operator(left(lookup), right(lookup))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            function, of = _CALLS[name], _compiled(argument)
            return lambda lookup: function(of(lookup))
        case ast.Call(func=ast.Name(id=name), args=[first, second]):
            function, left, right = _CALLS[name], _compiled(first), _compiled(second)
            return lambda lookup: function(left(lookup), right(lookup))
    raise AssertionError(ast.dump(node))


def quantity(scene: Scene, joint: int, name: str) -> Evaluated:
    """Return a quantity (N,) of the joint, or of the one whose number its name ends with."""
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
    """Coulomb friction (N,) at the place of every sample over its mean; 1 where none is told."""
    surface, q = scene.model.surfaces[joint], scene.motion.q[:, joint]
    if surface is None or len(surface.speeds) == 0:
        return np.ones_like(q)
    mean = surface.mean_coulomb(PLACES)
    low, high = surface.scaling.position
    return (
        surface.coulomb(np.clip(q, low, high)) / mean if mean > 0.0 else np.ones_like(q)
    )


def factor_of(tree: ast.expr, coefficient: str) -> ast.expr | None:
    """Return what a coefficient is multiplied by in a formula that is linear in it, or None."""
    match tree:
        case ast.Name(id=name):
            return ast.Constant(1.0) if name == coefficient else None
        case ast.UnaryOp(op=op, operand=inner):
            factor = factor_of(inner, coefficient)
            return None if factor is None else ast.UnaryOp(op, factor)
        case ast.BinOp(left=left, op=ast.Mult() as op, right=right):
            first, second = factor_of(left, coefficient), factor_of(right, coefficient)
            if first is None and second is None:
                return None
            return ast.BinOp(first or left, op, second or right)
        case ast.BinOp(left=left, op=ast.Div() as op, right=right):
            factor = factor_of(left, coefficient)
            return None if factor is None else ast.BinOp(factor, op, right)
        case ast.BinOp(left=left, op=(ast.Add() | ast.Sub()) as op, right=right):
            first, second = factor_of(left, coefficient), factor_of(right, coefficient)
            if first is None or second is None:
                minus = first is None and isinstance(op, ast.Sub) and second is not None
                return (
                    ast.UnaryOp(ast.USub(), second)
                    if minus and second
                    else first or second
                )
            return ast.BinOp(first, op, second)
    return None
