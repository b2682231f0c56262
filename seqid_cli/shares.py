"""Shares as people read them: the only way in which a percentage is printed."""

import math

MORE_DIGITS = 2  # that keep a small share from reading 0 %, and a large one 100 %

LARGEST_SHARE = 1e4  # that is printed


def change(before: float, after: float, least: float = 0.0) -> float:
    """Return a change as a share of what was before: 5.44 to 8.30 is +0.53.

    Parameters
    ----------
    before, after : float
    least : float
        Size that the number has at least. From a `before` below it, where a share of it
        says nothing, the change is a share of the larger of both. Numbers that get
        larger on their side of zero grow: -2 to -3 is +0.5.
    """
    size = abs(before)
    if size < least or size == 0.0:
        size = max(size, abs(after), least)
    if after == before or size == 0.0:
        return 0.0
    side = math.copysign(1.0, before if before else after)
    return side * (after - before) / size


def with_sign(text: str, value: float) -> str:
    """Return a number's text with a plus where the number is positive."""
    return f"+{text}" if value > 0.0 else text


def change_in_percent(share: float | None) -> str:
    """Return a change in percent with its sign, "+52.6 %"."""
    return "-" if share is None else with_sign(percent(share), share)


def percent(share: float, digits: int = 1) -> str:
    """Return a share in percent, "12.3 %".

    It has `digits` decimals, and more where it would else be rounded to 0 % or 100 %:
    a reader takes these for nothing and for all. A share that is not finite is "-", and
    one beyond `LARGEST_SHARE` no more than that: its whole is next to nothing.
    """
    if not math.isfinite(share):
        return "-"
    if abs(share) > LARGEST_SHARE:
        bound = f"{100.0 * LARGEST_SHARE:.0f} %"
        return f"> {bound}" if share > 0.0 else f"< -{bound}"
    for decimals in range(digits, digits + MORE_DIGITS + 1):
        text = f"{100.0 * share:.{decimals}f}"
        if share in (0.0, 1.0) or abs(float(text)) not in (0.0, 100.0):
            return f"{text} %"

    # Even with more decimals it reads as nothing, or as all.
    last_digit = 10.0**-decimals
    if 0.0 < share < 0.5:
        return f"< {last_digit:.{decimals}f} %"
    if 0.5 < share < 1.0:
        return f"> {100.0 - last_digit:.{decimals}f} %"
    return f"{text} %"
