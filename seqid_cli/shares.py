"""Shares as people read them: the one way to print a percentage."""

import math

MORE_DIGITS = 2  # that a share may be given so as not to look like none or all


def percent(share: float, digits: int = 1) -> str:
    """Return a share in percent; less than all never reads 100 %, more than none never 0 %.

    It has `digits` decimals, and more where it would else be rounded to 0 % or 100 %.
    """
    if not math.isfinite(share):
        return "-"
    for decimals in range(digits, digits + MORE_DIGITS + 1):
        text = f"{100.0 * share:.{decimals}f}"
        if share in (0.0, 1.0) or abs(float(text)) not in (0.0, 100.0):
            return f"{text} %"
    least = 10.0**-decimals
    if 0.0 < share < 0.5:
        return f"< {least:.{decimals}f} %"
    return f"> {100.0 - least:.{decimals}f} %" if 0.5 < share < 1.0 else f"{text} %"
