"""Which peaks of a guitar's taps are its air and its top."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tonewood.instrument.inspection.mode_names import mode_names
from tonewood.workshop.taps.ringing import Peak


def named(peaks: Sequence[Peak]) -> Mapping[str, Peak]:
    """Names of the certain peaks of a body with a soundhole, by `mode_names`.

    Parameters
    ----------
    peaks : by frequency.
    """
    sure = [peak for peak in peaks if peak.certain]
    return {name: sure[k] for name, k in mode_names([p.freq for p in sure], [p.level for p in sure]).items()}
