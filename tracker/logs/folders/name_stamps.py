"""Time from the names of files: stamps where the names are stamps, else numbers at a rate."""

from __future__ import annotations

import re
from collections.abc import Sequence

_FIRST, _LAST = 10**9, 41 * 10**8  # the years 2001 to 2099 [s since the epoch]
_PER_SECOND = (1, 10**3, 10**6, 10**9)
_NAME = re.compile(r"\D*?(\d{1,20})(\.\d{1,12})?")


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorting key: runs of digits by their value, the rest as text."""
    parts = re.findall(r"\d{1,300}|\D+", name)
    return tuple((0, int(part), "") if part[0].isdecimal() else (1, 0, part) for part in parts)


def stamps_of_names(names: Sequence[str]) -> list[float] | None:
    """Stamps [s] that the names (without suffix) are; None where they are none.

    A stamp is a number with a decimal point [s], or a whole number that is a time in this century in
    seconds, milliseconds, microseconds or nanoseconds since the epoch. Text before it is passed over.
    """
    matches = [_NAME.fullmatch(name) for name in names]
    if not names or not all(matches):
        return None
    parts = [(match[1], match[2]) for match in matches if match]
    if all(fraction for _, fraction in parts):
        return [float(whole + fraction) for whole, fraction in parts]
    if any(fraction for _, fraction in parts):
        return None
    numbers = [int(whole) for whole, _ in parts]
    for unit in _PER_SECOND:
        if min(numbers) >= _FIRST * unit and max(numbers) <= _LAST * unit:
            return [number / unit for number in numbers]
    return None


def counted_stamps(names: Sequence[str], rate: float) -> list[float]:
    """Stamps [s] at `rate` [Hz]: by the numbers in the names, so that missing ones are gaps, or in order."""
    matches = [_NAME.fullmatch(name) for name in names]
    numbers = [int(match[1]) for match in matches if match and not match[2] and len(match[1]) < 12]
    counted = len(numbers) == len(names) and len(set(numbers)) == len(names)
    return [number / rate for number in (numbers if counted else range(len(names)))]
