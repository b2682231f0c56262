"""Numbers and names as they stand on the page."""

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import PurePath

from markupsafe import Markup, escape

from seqid_cli import shares

Z95 = 1.959963984540054  # of a two-sided 95 % interval
MINUS = "\u2212"
# A standard parameter: its letter, its axes, the number of its link.
PARAMETER = re.compile(r"([A-Za-z])([A-Za-z]*)_([0-9]+)")
DASH = "\u2013"
_RAISED = str.maketrans("123-", "\u00b9\u00b2\u00b3\u207b")


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, a dash where there is none."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0.0:
        return "0"
    size = abs(value)
    if not 1e-4 <= size < 1e6:
        mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
        return f"{mantissa}e{int(power)}".replace("-", MINUS)
    decimals = max(0, digits - 1 - math.floor(math.log10(size)))
    return f"{value:.{decimals}f}".replace("-", MINUS)


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share in percent, a dash where there is none."""
    if share is None or not math.isfinite(share):
        return DASH
    return shares.percent(share, digits).replace("-", MINUS)


def _decimals(error: float) -> int | None:
    """Return the decimals that two digits of a standard error allow.

    None where fixed decimals do not help: of errors that are too small or too large.
    """
    if not (error > 0.0 and math.isfinite(error)):
        return None
    decimals = 1 - math.floor(math.log10(error))
    return decimals if 0 <= decimals <= 9 else None


def with_error(value: float, error: float) -> tuple[str, str]:
    """Return value and standard error with the decimals that the error allows."""
    decimals = _decimals(error)
    if decimals is None or not abs(value) < 1e9:
        return number(value, 5), number(error, 2)
    return f"{value:.{decimals}f}".replace("-", MINUS), f"{error:.{decimals}f}"


def interval(value: float, error: float) -> str:
    """Return the 95 % interval of a value with a normal standard error."""
    if not error > 0.0:
        return DASH
    low = value - Z95 * error
    high = value + Z95 * error
    decimals = _decimals(error)
    if decimals is None:
        return f"{number(low, 4)} to {number(high, 4)}"
    return f"{low:.{decimals}f} to {high:.{decimals}f}".replace("-", MINUS)


def unit_text(unit: str) -> str:
    """Return a unit with raised powers and thin spaces; nothing for a plain number."""
    if unit == "1":
        return ""
    raised = re.sub(r"\^(-?[123])", lambda match: match[1].translate(_RAISED), unit)
    return raised.replace(" ", "\u202f")


def symbol(name: str) -> Markup:
    """Return a standard parameter such as `Ixx_2` with its index lowered.

    Other names stay as they are.
    """
    match = PARAMETER.fullmatch(name)
    if match is None:
        return escape(name)
    base, axes, index = match.groups()
    if base == "m":  # the axis of a first moment stands beside it
        return Markup("<i>m</i>{}<sub>{}</sub>").format(axes, index)
    lowered = f"{axes}\u202f{index}" if axes else index
    return Markup("<i>{}</i><sub>{}</sub>").format(base, lowered)


def expression(terms: Mapping[str, float], fallback: str) -> Markup:
    """Return a sum of standard parameters as a formula.

    `terms` are their factors; without any the text `fallback` is the formula.
    """
    if not terms:
        return escape(fallback)
    formula = Markup("")
    for name, factor in terms.items():
        sign = MINUS if factor < 0.0 else "+"
        if formula:
            formula += f" {sign} "
        elif sign == MINUS:
            formula += sign
        size = abs(factor)
        is_one = abs(size - 1.0) < 1e-9
        formula += ("" if is_one else f"{size:.5g}\u202f") + symbol(name)
    return formula


def plural(count: int, noun: str) -> str:
    """Return a count with its noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def listed(names: Sequence[str], most: int = 6) -> str:
    """Return names as a list in words, cut after `most`."""
    if len(names) > most:
        return ", ".join(names[:most]) + f" and {len(names) - most} more"
    if len(names) > 1:
        return f"{', '.join(names[:-1])} and {names[-1]}"
    return names[0] if names else ""


def effect_at(effect: str, joint: str | None) -> str:
    """Return an effect in plain words with its place."""
    return f"{effect_words(effect)} at {joint}" if joint else effect_words(effect)


def effect_words(effect: str) -> str:
    """Return the name of an effect in plain words."""
    return effect.replace("_", " ")


def command(*words: str) -> str:
    """Return a command line that a shell takes as it stands.

    Places that a reader fills in, such as LOG..., are not quoted.
    """
    quoted = [word if word.endswith("...") else shlex.quote(word) for word in words]
    return " ".join(quoted)


def file_name(path: str) -> str:
    """Return the last part of a path."""
    return PurePath(path.replace("\\", "/")).name or path


def short_path(path: str) -> str:
    """Return the last two parts of a path."""
    parts = PurePath(path.replace("\\", "/")).parts
    return "/".join(parts[-2:]) if len(parts) > 1 else path
