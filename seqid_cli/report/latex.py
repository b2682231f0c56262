"""Parameters as a LaTeX table, for a paper or a data sheet."""

import re
from collections.abc import Iterator

from seqid_cli.effects.units import UNEXPLAINED
from seqid_cli.params.schema import Parameter, ParameterFile
from seqid_cli.report import words
from seqid_cli.visible import visible

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}
_STAGES = {"gravity": "Gravity", "inertia": "Inertia"}


def parameter_table(file: ParameterFile) -> str:
    """Return base parameters and effects of a file as a `tabular` of booktabs.

    Parameters
    ----------
    file : ParameterFile

    Returns
    -------
    str
        Values have the decimals that their standard errors allow.
    """
    lines = [
        f"% {_comment(file.robot.name)}, by seqid {_comment(file.tool.version)};"
        r" needs \usepackage{booktabs}",
        r"\begin{tabular}{lrrll}",
        r"\toprule",
        r"parameter & value & std.\ error & unit & stands for \\",
    ]
    for title, rows in _groups(file):
        lines += [r"\midrule", rf"\multicolumn{{5}}{{l}}{{{title}}} \\", *rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _groups(file: ParameterFile) -> Iterator[tuple[str, list[str]]]:
    """Yield the title and the rows of each stage and each effect."""
    for name, title in _STAGES.items():
        stage = getattr(file.stages, name)
        if stage is not None and stage.parameters:
            yield title, [_row(item) for item in stage.parameters]
    for effect in file.stages.effects or []:
        if effect.effect == UNEXPLAINED:
            continue
        place = effect.joint or "the whole arm"
        title = _text(words.effect_at(effect.effect, place))
        yield title, [_row(item) for item in effect.parameters]


def _row(item: Parameter) -> str:
    """Return the row of one parameter."""
    value, error = words.DASH, "not determined"
    if item.std_error is not None:
        value, error = words.with_error(item.value, item.std_error)
    cells = [
        f"${_symbol(item.name)}$",
        _number(value),
        _number(error),
        _unit(item.unit),
        f"${_sum(item)}$" if item.terms else _text(item.expression),
    ]
    return " & ".join(cells) + r" \\"


def _sum(item: Parameter) -> str:
    """Return what a base parameter stands for as a formula."""
    formula = ""
    for name, factor in item.terms.items():
        sign = "-" if factor < 0.0 else "+"
        if formula or sign == "-":
            formula += f" {sign} "
        size = abs(factor)
        if abs(size - 1.0) >= 1e-9:
            formula += _power(f"{size:.5g}") + r"\,"
        formula += _symbol(name)
    return formula.strip()


def _symbol(name: str) -> str:
    """Return a parameter's name in math mode: `Ixx_2` with its indices lowered."""
    match = words.PARAMETER.fullmatch(name)
    if match is None:
        return rf"\mathrm{{{_text(words.effect_words(name))}}}".replace(" ", r"\ ")
    base, axes, index = match.groups()
    if base == "m" and axes:  # a first moment: mass times a coordinate
        return f"m {axes}_{{{index}}}"
    lowered = f"{axes},{index}" if axes else index
    return f"{base}_{{{lowered}}}"


def _number(text: str) -> str:
    """Return a number as the page has it, in math mode; other texts as they are."""
    plain = text.replace(words.MINUS, "-")
    if re.fullmatch(r"-?[0-9.]+(e-?[0-9]+)?", plain):
        return f"${_power(plain)}$"
    return "--" if text == words.DASH else _text(plain)


def _power(text: str) -> str:
    """Return a number whose power of ten is written out."""
    mantissa, _, power = text.partition("e")
    return rf"{mantissa}\cdot 10^{{{int(power)}}}" if power else mantissa


def _unit(unit: str) -> str:
    """Return a unit with raised powers; nothing for a plain number."""
    if unit == "1":
        return ""
    raised = re.sub(r"\^(-?[0-9]+)", r"\\textsuperscript{\1}", unit)
    return raised.replace(" ", r"\,").replace("%", r"\%")


def _text(text: str) -> str:
    """Return text of a file with what LaTeX would take for a command written out."""
    return "".join(_SPECIAL.get(letter, letter) for letter in visible(text))


def _comment(text: str) -> str:
    """Return text for a comment, which ends where the line does."""
    return visible(" ".join(text.split()))
