"""Numbers in text for people."""

from __future__ import annotations

import math


def percent(value: float) -> str:
    """Return 0.00853 as "0.85 %", 0.01 as "1 %", and values below 0.001 % with an exponent."""
    if 0 < value < 1e-5:
        return f"{100 * value:.0e} %"
    return f"{two_digits(100 * value)} %"


def seconds_text(value: float) -> str:
    """Return a duration with a suitable unit: "2.1 ms"."""
    for unit, name in ((1.0, "s"), (1e-3, "ms")):
        if value >= unit:
            return f"{two_digits(value / unit)} {name}"
    return f"{two_digits(value / 1e-6)} µs"


def two_digits(value: float) -> str:
    """Return two digits without exponent or trailing zeros: 410, 4.1, 4, 0.041."""
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    decimals = 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, decimals):.{max(0, decimals)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
