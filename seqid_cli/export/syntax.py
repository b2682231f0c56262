"""Terms of laws in C99 and in Python with numpy: what differs between the two."""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from seqid_cli.effects.law import direction_of
from seqid_cli.export.text import real

Named = Callable[[str], str]  # the text that stands for a name, "sign(dq)" among them

_OPERATORS: Mapping[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
}


@dataclass(frozen=True, kw_only=True)
class Syntax:
    """A language that code is exported in.

    Attributes
    ----------
    functions : mapping
        What the functions of a term are called, and `power`.
    helper : str
        What stands before the names of functions that the file itself has.
    state : str
        What stands before the fields of the state.
    let, comment, end : str
        How a value gets its name, how a comment begins, how a statement and a comment
        end.
    braces : bool
        Whether blocks stand in braces, or are indented alone.
    has_temperature : str
        The condition that the temperature of joint `{j}` was given and is a number.
    also : str
        How two conditions are joined.
    """

    functions: Mapping[str, str]
    helper: str
    state: str
    let: str
    comment: tuple[str, str]
    end: str
    braces: bool
    has_temperature: str
    also: str

    def term(self, tree: ast.expr, named: Named) -> str:
        """Write a tree; operations within others stand in brackets."""
        text = self.factor(tree, named)
        if isinstance(tree, ast.BinOp) and text.startswith("("):
            return text[1:-1]
        return text

    def factor(self, tree: ast.expr, named: Named) -> str:
        """Write a tree as it can stand within another, operations in brackets.

        Parameters
        ----------
        tree : ast.expr
            A term, or a part of one.
        named : callable
            Returns the text that stands for a name.
        """
        direction = direction_of(tree)
        if direction is not None:
            return named(f"sign({direction})")

        match tree:
            case ast.Constant(value=value):
                return real(float(value))  # type: ignore[arg-type]
            case ast.Name(id=name):
                return named(name)
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                text = self.factor(inner, named)
                if text.startswith("-"):  # two signs in a row would be a decrement
                    text = f"({text})"
                return f"(-{text})"
            case ast.UnaryOp(operand=inner):
                return self.factor(inner, named)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                base = self.factor(left, named)
                exponent = self.factor(right, named)
                return self.call("power", base, exponent)
            case ast.BinOp(left=left, op=op, right=right):
                first = self.factor(left, named)
                second = self.factor(right, named)
                return f"({first} {_OPERATORS[type(op)]} {second})"
            case ast.Call(func=ast.Name(id=name), args=arguments):
                texts = [self.term(argument, named) for argument in arguments]
                return self.call(name, *texts)
        # The grammar of laws has nothing else.
        raise AssertionError(ast.dump(tree))

    def call(self, name: str, *arguments: str) -> str:
        """Write the call of a function of terms, or of one that the file has."""
        function = self.functions.get(name, f"{self.helper}{name}")
        return f"{function}({', '.join(arguments)})"

    def value(self, name: str, text: str) -> str:
        """Give a value a name."""
        return f"{self.let}{name} = {text}{self.end}"

    def statement(self, text: str) -> str:
        """Write a statement."""
        return f"{text}{self.end}"

    def block(self, title: str, lines: Sequence[str], condition: str = "") -> list[str]:
        """Write lines under a comment, and under a condition if there is one.

        Parameters
        ----------
        title : str
            The comment.
        lines : sequence of str
            Statements, not indented.
        condition : str
            Under which they are run; always where it is empty.
        """
        heading = self.remark(title)
        inner = [f"    {line}" for line in lines]
        if self.braces:
            opening = f"if ({condition}) {{" if condition else "{"
            return [f"{opening} {heading}", *inner, "}"]
        if condition:
            return [f"if {condition}:  {heading}", *inner]
        return [heading, *lines]

    def remark(self, text: str) -> str:
        """Write a comment."""
        opening, closing = self.comment
        return f"{opening}{text}{closing}"


def c99(prefix: str) -> Syntax:
    """Return C99, for functions that begin with a prefix."""
    names = ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "asin")
    functions = {name: name for name in names}
    functions |= {"abs": "fabs", "min": "fmin", "max": "fmax", "power": "pow"}
    return Syntax(
        functions=functions,
        helper=f"{prefix}_seqid_",
        state="s->",
        let="const double ",
        comment=("/* ", " */"),
        end=";",
        braces=True,
        has_temperature="temperature && isfinite(temperature[{j}])",
        also="&&",
    )


def python() -> Syntax:
    """Return Python with numpy."""
    names = ("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "power")
    functions = {name: f"np.{name}" for name in names}
    functions |= {"min": "np.minimum", "max": "np.maximum", "asin": "np.arcsin"}
    return Syntax(
        functions=functions,
        helper="_",
        state="self.",
        let="",
        comment=("# ", ""),
        end="",
        braces=False,
        has_temperature="temperature is not None and np.isfinite(temperature[{j}])",
        also="and",
    )
