"""Shares as people read them: the only way in which a percentage is printed."""

import math

MORE_DIGITS = 2  # that keep a small share from reading 0 %, and a large one 100 %


def percent(share: float, digits: int = 1) -> str:
    """Return a share in percent, "12.3 %".

    It has `digits` decimals, and more where it would else be rounded to 0 % or 100 %:
    a reader takes these for nothing and for all. A share that is not finite is "-".
    """
    if not math.isfinite(share):
        return "-"
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
