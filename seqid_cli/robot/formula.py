"""Formulas of own effects in a robot file: a small grammar, read by Python's parser, never run.

    torque = "c1 * sign(dq) * abs(load) + c2 * tanh(dq / width)"

A formula is a sum of terms that are each linear in one coefficient (`c`, or `c1`, `c2`, ...). It
may also hold numbers, `+ - * / **`, the functions and symbols below, and its own settings, which
are searched. A symbol is of the effect's own joint; `dq_2` is that of the second joint.
"""

import ast
import difflib
import re
import sys
import warnings
from collections.abc import Collection
from dataclasses import dataclass

SYMBOLS = {
    "q": "position, rad",
    "dq": "velocity, rad/s",
    "ddq": "acceleration, rad/s^2",
    "theta": "angle of the motor, rad",
    "load": "modelled torque that the gear passes to the link, N m",
    "friction": "modelled friction, N m",
    "tau": "modelled torque of the drive, N m",
    "temperature": "logged temperature, degC",
    "t": "time since the session's start, s",
}
FUNCTIONS = ("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "min", "max")
LONGEST, DEEPEST = 500, 40  # characters; operations within each other

_COEFFICIENT = re.compile(r"c[0-9]{0,2}")
_SYMBOL = re.compile(rf"({'|'.join(SYMBOLS)})(?:_([1-9][0-9]{{0,2}}))?")


class FormulaError(ValueError):
    """A formula that cannot be used: why, and at which column of its text, from 1."""

    def __init__(self, reason: str, column: int | None = None) -> None:
        super().__init__(reason)
        self.reason, self.column = reason, column

    def __str__(self) -> str:
        return self.reason if self.column is None else f"{self.reason} (column {self.column})"


@dataclass(frozen=True)
class Symbol:
    """A quantity of a joint: its own (None) or the one of a number, from 0."""

    name: str
    joint: int | None = None


@dataclass(frozen=True)
class Formula:
    """A formula that was checked: its tree, coefficients, and symbols."""

    text: str
    tree: ast.expr
    coefficients: tuple[str, ...]
    symbols: frozenset[Symbol]


def parse_formula(text: str, joints: int, settings: Collection[str] = ()) -> Formula:
    """Check a formula.

    `joints`: number of joints of the robot. `settings`: names of its own that stand for numbers to
    be searched.

    Raises FormulaError: it is no sum of terms that are linear in one coefficient each.
    """
    if len(text) > LONGEST:
        raise FormulaError(f"is {len(text)} characters long, more than {LONGEST}")
    before = len(text) - len(text.lstrip())
    tree = _tree(text.strip(), before)
    reader = _Reader(joints, frozenset(settings), before)
    if not reader.linear(tree, 0):
        raise FormulaError("has no coefficient: write one (c, or c1, c2, ...) before each term")
    unused = sorted(set(settings) - reader.used)
    if unused:
        raise FormulaError(f"does not use the setting {unused[0]!r}")
    names = sorted(reader.coefficients, key=lambda name: int(name[1:] or 0))
    return Formula(text, tree, tuple(names), frozenset(reader.symbols))


def _tree(text: str, before: int) -> ast.expr:
    for k, sign in enumerate(text):
        if not " " <= sign <= "~":
            raise FormulaError(f"cannot be read: has {sign!a}", before + k + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's advice on text that is refused anyway
            return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as problem:
        reason = getattr(problem, "msg", None) or str(problem) or "too deep"
        column = getattr(problem, "offset", 0) or len(text) + 1  # 0: it ends too early
        raise FormulaError(f"cannot be read: {reason}", before + column) from None


def symbol_of(name: str) -> Symbol | None:
    """The quantity that a name stands for; None if for none."""
    match = _SYMBOL.fullmatch(name)
    if match is None:
        return None
    return Symbol(match[1], int(match[2]) - 1 if match[2] else None)


def is_coefficient(name: str) -> bool:
    """Whether a name is that of a coefficient."""
    return _COEFFICIENT.fullmatch(name) is not None


class _Reader:
    """Walks through a tree; decides whether each part is linear in coefficients or free of them."""

    def __init__(self, joints: int, settings: frozenset[str], before: int) -> None:
        self.joints, self.settings, self.before = joints, settings, before
        self.coefficients: set[str] = set()
        self.symbols: set[Symbol] = set()
        self.used: set[str] = set()

    def linear(self, node: ast.expr, depth: int) -> bool:
        """Whether it holds coefficients; raises where it is neither linear in nor free of them."""
        if depth > DEEPEST:
            raise FormulaError(f"is nested more than {DEEPEST} deep")
        try:
            return self._linear(node, depth)
        except FormulaError as problem:
            if problem.column is None:
                problem.column = self.before + node.col_offset + 1
            raise

    def _linear(self, node: ast.expr, depth: int) -> bool:
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                if not abs(value) <= sys.float_info.max:
                    raise FormulaError("has a number that is too large")
                return False
            case ast.Name(id=name):
                return self._name(name)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
                return self.linear(inner, depth + 1)
            case ast.BinOp(left=left, op=op, right=right):
                sides = self.linear(left, depth + 1), self.linear(right, depth + 1)
                return _combined(op, *sides)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._call(name, arguments, depth)
        raise FormulaError(f"has {ast.unparse(node)!r}, which no formula may have")

    def _name(self, name: str) -> bool:
        symbol = symbol_of(name)
        if symbol is not None:
            if symbol.joint is not None and symbol.joint >= self.joints:
                raise FormulaError(f"names {name!r}, but the robot has {self.joints} joints")
            self.symbols.add(symbol)
        elif name in self.settings:
            self.used.add(name)
        elif is_coefficient(name):
            self.coefficients.add(name)
            return True
        else:
            known = [*SYMBOLS, *FUNCTIONS, *self.settings]
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
            offer = f"; did you mean {near[0]!r}?" if near else f"; it may have {', '.join(known)}"
            raise FormulaError(f"has {name!r}{offer}")
        return False

    def _call(self, name: str, arguments: list[ast.expr], depth: int) -> bool:
        if name not in FUNCTIONS:
            raise FormulaError(f"calls {name!r}; it may call {', '.join(FUNCTIONS)}")
        wanted = 2 if name in {"min", "max"} else 1
        if len(arguments) != wanted:
            raise FormulaError(f"calls {name} with {len(arguments)} arguments, it takes {wanted}")
        if any(self.linear(argument, depth + 1) for argument in arguments):
            raise FormulaError(f"has a coefficient inside {name}(): terms must be linear in them")
        return False


def _combined(op: ast.operator, left: bool, right: bool) -> bool:
    """Whether two sides together hold coefficients, linearly."""
    match op:
        case ast.Add() | ast.Sub():
            if left != right:
                raise FormulaError("has a term without a coefficient beside one that has it")
            return left
        case ast.Mult():
            if left and right:
                raise FormulaError("multiplies coefficients: terms must be linear in one each")
            return left or right
        case ast.Div() if not right:
            return left
        case ast.Pow() if not (left or right):
            return False
        case ast.Div() | ast.Pow():
            raise FormulaError("divides by a coefficient, or has a power of or with one")
    raise FormulaError("has an operator other than + - * / **")
