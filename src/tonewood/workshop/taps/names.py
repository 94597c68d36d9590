"""Which peaks of a guitar's taps are its air and its top: by order, ratio and level alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tonewood.workshop.taps.ringing import Peak

#: Hz, of A0: from a bass guitar's box to a ukulele's or a violin's
_AIR = (50.0, 350.0)
#: T1 re A0, and T2 re T1: guitars have 1.6 to 2.4 and 1.2 to 2.0
_FIRST, _SECOND = (1.4, 2.8), (1.12, 2.2)
#: dB below the strongest peak at which one may be A0, and below the strongest of its range one may be T1 or T2
_WEAK, _BESIDE = 25.0, 10.0


def named(peaks: Sequence[Peak]) -> Mapping[str, Peak]:
    """Names of peaks of a body with a soundhole, as far as they are there: A0, T1, T2.

    A0 (air in the hole, with the top in phase) is the lowest certain peak from 50 to 350 Hz; T1 (the top, with the air
    against it) the lowest of those within 10 dB of the strongest from 1.4 to 2.8 times A0; T2 the same from 1.12 to 2.2
    times T1. Printed values of classical guitars: A0 90 to 120, T1 170 to 250 Hz. Taps do not show shapes: a second
    recording with the hole covered, where A0 is gone, tells more.

    Parameters
    ----------
    peaks : by frequency.
    """
    sure = [peak for peak in peaks if peak.certain and peak.level > -_WEAK]
    out: dict[str, Peak] = {}
    air = [peak for peak in sure if _AIR[0] <= peak.freq <= _AIR[1]]
    if not air:
        return out
    out["A0"] = air[0]
    for name, below, (low, high) in (("T1", "A0", _FIRST), ("T2", "T1", _SECOND)):
        first = out[below].freq
        near = [peak for peak in sure if low * first < peak.freq < high * first]
        if not near:
            break
        strongest = max(peak.level for peak in near)
        out[name] = next(peak for peak in near if peak.level > strongest - _BESIDE)
    return out
