"""Notes of a sample library: which keys and velocities are rendered, and the keys and velocities each sample serves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tonewood.errors import TonewoodError
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_name

#: velocity that MIDI allows at most
_LOUDEST = 127


@dataclass(frozen=True)
class Span:
    """Numbers from `low` to `high`, both included, that the sample made at `centre` serves."""

    centre: int
    low: int
    high: int


def spans(centres: Sequence[int], low: int, high: int) -> list[Span]:
    """Divide the numbers from `low` to `high` among centres: each to the nearest, in the middle to the higher."""
    ordered = sorted(set(centres))
    borders = [low, *(-(-(a + b) // 2) for a, b in pairwise(ordered)), high + 1]
    return [Span(c, a, b - 1) for c, (a, b) in zip(ordered, pairwise(borders), strict=True)]


def key_spans(lowest: int, highest: int, step: int) -> list[Span]:
    """Return every `step`-th key from the lowest to the highest, and the highest itself."""
    centres = [*range(lowest, highest + 1, step)]
    if centres[-1] != highest:
        centres.append(highest)
    return spans(centres, lowest, highest)


def velocity_spans(velocities: Sequence[int]) -> list[Span]:
    """Return the layers of velocities (1 to 127).

    Raises TonewoodError : there is none, one twice, or one out of range.
    """
    if not velocities or len(set(velocities)) < len(velocities) or not all(1 <= v <= _LOUDEST for v in velocities):
        text = ", ".join(map(str, velocities)) or "empty"
        raise TonewoodError(f"is {text}; different numbers from 1 to {_LOUDEST} are allowed", key="velocities")
    return spans(velocities, 1, _LOUDEST)


def compass(model: Model) -> tuple[int, int]:
    """Return the lowest and highest MIDI number that the instrument's strings can be stopped at."""
    strings = [model.strings[name] for name in model.groups]
    low = min(round(s.open_note) for s in strings)
    return low, max(round(s.open_note + s.n_stops) for s in strings)


def sample_name(key: int, velocity: int, repeat: int, *, release: bool = False) -> str:
    """Return the name of a sample's file without its suffix: ``As2_v064_r1``; a sharp sign would end an address."""
    kind = "release_" if release else ""
    return f"{kind}{note_name(key).replace('#', 's')}_v{velocity:03d}_r{repeat}"
