"""Formulas of own effects in a robot file: a small grammar.

Python's parser reads a formula; nothing is ever run.

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
LONGEST = 500  # characters
DEEPEST = 40  # operations within each other

_COEFFICIENT = re.compile(r"c[0-9]{0,2}")
_SYMBOL = re.compile(rf"({'|'.join(SYMBOLS)})(?:_([1-9][0-9]{{0,2}}))?")


class FormulaError(ValueError):
    """A formula that cannot be used: why, and at which column of its text, from 1."""


@dataclass(frozen=True)
class Symbol:
    """A quantity of a joint."""

    name: str
    joint: int | None = None  # 0-based; None: the effect's own joint


@dataclass(frozen=True)
class Formula:
    """A formula that was checked."""

    text: str
    tree: ast.expr
    coefficients: tuple[str, ...]  # in the order of their numbers
    symbols: frozenset[Symbol]


def parse_formula(text: str, joints: int, settings: Collection[str] = ()) -> Formula:
    """Check a formula.

    Parameters
    ----------
    text : str
        The formula.
    joints : int
        Joints of the arm.
    settings : collection of str
        Names of the numbers in it that are to be searched.

    Raises
    ------
    FormulaError
        It is no sum of terms that are linear in one coefficient each.
    """
    if len(text) > LONGEST:
        raise FormulaError(f"is {len(text)} characters long, more than {LONGEST}")
    n_spaces = len(text) - len(text.lstrip())
    tree = _tree(text.strip(), n_spaces)
    reader = _Reader(joints, frozenset(settings), n_spaces)
    if not reader.linear(tree, 0):
        raise FormulaError(
            "has no coefficient: write one (c, or c1, c2, ...) before each term"
        )
    unused = sorted(set(settings) - reader.used_settings)
    if unused:
        raise FormulaError(f"does not use the setting {unused[0]!r}")
    names = sorted(reader.coefficients, key=lambda name: int(name[1:] or 0))
    return Formula(text, tree, tuple(names), frozenset(reader.symbols))


def _tree(text: str, n_spaces: int) -> ast.expr:
    """Parse a formula; `n_spaces` stand before it, for the columns in messages."""
    for column, sign in enumerate(text, n_spaces + 1):
        if not " " <= sign <= "~":
            raise FormulaError(f"cannot be read: has {sign!a} (column {column})")
    try:
        with warnings.catch_warnings():
            # Python's advice on text that is refused anyway
            warnings.simplefilter("ignore")
            return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as problem:
        reason = getattr(problem, "msg", None) or str(problem) or "too deep"
        # 0: it ends too early
        column = n_spaces + (getattr(problem, "offset", 0) or len(text) + 1)
        raise FormulaError(f"cannot be read: {reason} (column {column})") from None


def symbol_of(name: str) -> Symbol | None:
    """Return the quantity that a name stands for; None if for none."""
    match = _SYMBOL.fullmatch(name)
    if match is None:
        return None
    quantity, number = match.groups()
    return Symbol(quantity, int(number) - 1 if number else None)


def is_coefficient(name: str) -> bool:
    """Tell whether a name is that of a coefficient."""
    return _COEFFICIENT.fullmatch(name) is not None


class _Reader:
    """Walks through a tree; each part is linear in coefficients or free of them."""

    def __init__(self, joints: int, settings: frozenset[str], n_spaces: int) -> None:
        self.joints = joints
        self.settings = settings
        self.n_spaces = n_spaces
        self.coefficients: set[str] = set()
        self.symbols: set[Symbol] = set()
        self.used_settings: set[str] = set()

    def linear(self, node: ast.expr, depth: int) -> bool:
        """Tell whether a part holds coefficients.

        Raises FormulaError where it is neither linear in them nor free of them.
        """
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
                left_is_linear = self.linear(left, deeper)
                right_is_linear = self.linear(right, deeper)
                return self._combined(node, op, left_is_linear, right_is_linear)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                self._check_call(node, name, arguments, deeper)
                return False
        raise self._refused(
            node, f"has {ast.unparse(node)!r}, which no formula may have"
        )

    def _refused(self, node: ast.expr, reason: str) -> FormulaError:
        """Make the error for a part of the formula."""
        column = self.n_spaces + node.col_offset + 1
        return FormulaError(f"{reason} (column {column})")

    def _check_call(
        self, node: ast.expr, name: str, arguments: list[ast.expr], depth: int
    ) -> None:
        """Raise FormulaError for a call that may not be, or that holds coefficients."""
        n_arguments = 2 if name in {"min", "max"} else 1
        if name not in FUNCTIONS:
            raise self._refused(
                node, f"calls {name!r}; it may call {', '.join(FUNCTIONS)}"
            )
        if len(arguments) != n_arguments:
            raise self._refused(
                node,
                f"calls {name} with {len(arguments)} arguments, it takes {n_arguments}",
            )
        if any(self.linear(argument, depth) for argument in arguments):
            raise self._refused(
                node, f"has a coefficient inside {name}(): terms must be linear in them"
            )

    def _name(self, node: ast.expr, name: str) -> bool:
        """Take a name; tell whether it is a coefficient."""
        symbol = symbol_of(name)
        if symbol is not None:
            if symbol.joint is not None and symbol.joint >= self.joints:
                raise self._refused(
                    node, f"names {name!r}, but the robot has {self.joints} joints"
                )
            self.symbols.add(symbol)
            return False
        if name in self.settings:
            self.used_settings.add(name)
            return False
        if is_coefficient(name):
            self.coefficients.add(name)
            return True

        allowed = [*SYMBOLS, *FUNCTIONS, *self.settings]
        close = difflib.get_close_matches(name, allowed, n=1, cutoff=0.5)
        offer = f"it may have {', '.join(allowed)}"
        if close:
            offer = f"did you mean {close[0]!r}?"
        raise self._refused(node, f"has {name!r}; {offer}")

    def _combined(
        self, node: ast.expr, op: ast.operator, left: bool, right: bool
    ) -> bool:
        """Tell whether an operation holds coefficients.

        `left`, `right`: whether the sides do. Raises FormulaError where it is not
        linear in them.
        """
        if isinstance(op, ast.Add | ast.Sub):
            if left == right:
                return left
            reason = "has a term without a coefficient beside one that has it"
        elif isinstance(op, ast.Mult):
            if not (left and right):
                return left or right
            reason = "multiplies coefficients: terms must be linear in one each"
        elif isinstance(op, ast.Div | ast.Pow):
            if not left and not right:
                return False
            if isinstance(op, ast.Div) and not right:
                return True
            reason = "divides by a coefficient, or has a power of or with one"
        else:
            reason = "has an operator other than + - * / **"
        raise self._refused(node, reason)
