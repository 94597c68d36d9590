"""The few units besides SI that people name pitch, level and decay in; numbers in texts, counts with their nouns."""

from __future__ import annotations

import math
import re

#: natural logarithm of 1000: a level falls by 60 dB in T60 = LN_1000 / sigma
LN_1000 = math.log(1000.0)

_DECIMAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


def as_float(value: float) -> float:
    """Number as a float; infinite if it is an integer beyond the largest one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def cents(ratio: float) -> float:
    """Cents of a frequency ratio: 1200 log2."""
    return 1200.0 * math.log2(ratio)


def ratio_of_cents(value: float) -> float:
    """Frequency ratio of an interval in cents."""
    return math.exp2(value / 1200.0)


def decibel(ratio: float) -> float:
    """Level of an amplitude ratio, dB; -inf for 0."""
    return 20.0 * math.log10(ratio) if ratio > 0 else -math.inf


def t60(damping_rate: float) -> float:
    """Time in which an oscillation of damping rate sigma (1/s) falls by 60 dB, s."""
    return LN_1000 / damping_rate if damping_rate > 0 else math.inf


def number_in(text: str) -> float:
    """Number that a text writes with the digits 0 to 9; NaN for any other text, such as ``1_82``, ``٣`` or ``inf``."""
    text = text.strip()
    return float(text) if _DECIMAL.fullmatch(text) else math.nan


def counted(count: int, noun: str) -> str:
    """A number with its noun: ``1 channel``, ``2 channels``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
