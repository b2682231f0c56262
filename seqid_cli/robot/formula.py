"""Formulas of own effects in a robot file: a small grammar, read by Python's parser, never run.

    torque = "c1 * sign(dq) * abs(load) + c2 * tanh(dq / width)"

A formula is a sum of terms that are each linear in one coefficient (`c`, or `c1`, `c2`,
...). It may also hold numbers, `+ - * / **`, the functions and symbols below, and its
own settings, which are searched. A symbol is of the effect's own joint; `dq_2` is that
of the second joint.
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
FUNCTIONS = (
    "abs",
    "sign",
    "sqrt",
    "exp",
    "log",
    "sin",
    "cos",
    "tan",
    "tanh",
    "min",
    "max",
)
LONGEST, DEEPEST = 500, 40  # characters; operations within each other

_COEFFICIENT = re.compile(r"c[0-9]{0,2}")
_SYMBOL = re.compile(rf"({'|'.join(SYMBOLS)})(?:_([1-9][0-9]{{0,2}}))?")


class FormulaError(ValueError):
    """A formula that cannot be used: why, and at which column of its text, from 1."""


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
    """Check a formula for an arm of so many joints; `settings` name numbers to be searched.

    Raises FormulaError: it is no sum of terms that are linear in one coefficient each.
    """
    if len(text) > LONGEST:
        raise FormulaError(f"is {len(text)} characters long, more than {LONGEST}")
    before = len(text) - len(text.lstrip())
    tree = _tree(text.strip(), before)
    reader = _Reader(joints, frozenset(settings), before)
    if not reader.linear(tree, 0):
        raise FormulaError(
            "has no coefficient: write one (c, or c1, c2, ...) before each term"
        )
    unused = sorted(set(settings) - reader.used)
    if unused:
        raise FormulaError(f"does not use the setting {unused[0]!r}")
    names = sorted(reader.coefficients, key=lambda name: int(name[1:] or 0))
    return Formula(text, tree, tuple(names), frozenset(reader.symbols))


def _tree(text: str, before: int) -> ast.expr:
    for k, sign in enumerate(text, before + 1):
        if not " " <= sign <= "~":
            raise FormulaError(f"cannot be read: has {sign!a} (column {k})")
    try:
        with warnings.catch_warnings():
            # Python's advice on text that is refused anyway
            warnings.simplefilter("ignore")
            return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as problem:
        reason = getattr(problem, "msg", None) or str(problem) or "too deep"
        # 0: it ends too early
        column = before + (getattr(problem, "offset", 0) or len(text) + 1)
        raise FormulaError(f"cannot be read: {reason} (column {column})") from None


def symbol_of(name: str) -> Symbol | None:
    """The quantity that a name stands for; None if for none."""
    match = _SYMBOL.fullmatch(name)
    return (
        None
        if match is None
        else Symbol(match[1], int(match[2]) - 1 if match[2] else None)
    )


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
        deeper = depth + 1
        match node:
            case _ if depth > DEEPEST:
                raise self._refused(node, f"is nested more than {DEEPEST} deep")
            case ast.Constant(value=int() | float() as value) if not isinstance(
                value, bool
            ):
                if not abs(value) <= sys.float_info.max:
                    raise self._refused(node, "has a number that is too large")
                return False
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
                return self.linear(inner, deeper)
            case ast.BinOp(left=left, op=op, right=right):
                sides = self.linear(left, deeper), self.linear(right, deeper)
                return self._combined(node, op, *sides)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                wanted = 2 if name in {"min", "max"} else 1
                reason = (
                    f"has a coefficient inside {name}(): terms must be linear in them"
                )
                if name not in FUNCTIONS:
                    reason = f"calls {name!r}; it may call {', '.join(FUNCTIONS)}"
                elif len(arguments) != wanted:
                    reason = (
                        f"calls {name} with {len(arguments)} arguments, it takes"
                        f" {wanted}"
                    )
                elif not any(self.linear(argument, deeper) for argument in arguments):
                    return False
                raise self._refused(node, reason)
        raise self._refused(
            node, f"has {ast.unparse(node)!r}, which no formula may have"
        )

    def _refused(self, node: ast.expr, reason: str) -> FormulaError:
        return FormulaError(f"{reason} (column {self.before + node.col_offset + 1})")

    def _name(self, node: ast.expr, name: str) -> bool:
        symbol = symbol_of(name)
        if symbol is not None:
            if symbol.joint is not None and symbol.joint >= self.joints:
                few = f"the robot has {self.joints} joints"
                raise self._refused(node, f"names {name!r}, but {few}")
            self.symbols.add(symbol)
        elif name in self.settings:
            self.used.add(name)
        elif is_coefficient(name):
            self.coefficients.add(name)
            return True
        else:
            known = [*SYMBOLS, *FUNCTIONS, *self.settings]
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
            offer = (
                f"did you mean {near[0]!r}?"
                if near
                else f"it may have {', '.join(known)}"
            )
            raise self._refused(node, f"has {name!r}; {offer}")
        return False

    def _combined(
        self, node: ast.expr, op: ast.operator, left: bool, right: bool
    ) -> bool:
        """Whether two sides together hold coefficients, linearly."""
        match op:
            case ast.Add() | ast.Sub() if left == right:
                return left
            case ast.Add() | ast.Sub():
                reason = "has a term without a coefficient beside one that has it"
            case ast.Mult() if not (left and right):
                return left or right
            case ast.Mult():
                reason = "multiplies coefficients: terms must be linear in one each"
            case ast.Div() | ast.Pow() if not right and not (
                left and isinstance(op, ast.Pow)
            ):
                return left
            case ast.Div() | ast.Pow():
                reason = "divides by a coefficient, or has a power of or with one"
            case _:
                reason = "has an operator other than + - * / **"
        raise self._refused(node, reason)
