"""Which resonances of a guitar are its air and its top: by order, ratio and level alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

#: Hz, of A0: from a bass guitar's box to a ukulele's or a violin's
_AIR = (50.0, 350.0)
#: T1 re A0, and T2 re T1: guitars have 1.6 to 2.4 and 1.2 to 2.0
_FIRST, _SECOND = (1.4, 2.8), (1.12, 2.2)
#: dB below the strongest resonance at which one may be A0, and below the strongest of its range one may be T1 or T2
_WEAK, _BESIDE = 25.0, 10.0


def mode_names(freq: ArrayLike, level_db: ArrayLike) -> dict[str, int]:
    """Numbers of the resonances called A0, T1, T2 of a body with a soundhole, as far as they are there.

    A0 (air in the hole, with the top in phase) is the lowest from 50 to 350 Hz within 25 dB of the strongest; T1 (the
    top, with the air against it) the lowest of those within 10 dB of the strongest from 1.4 to 2.8 times A0; T2 the
    same from 1.12 to 2.2 times T1. Printed values of classical guitars: A0 90 to 120, T1 170 to 250 Hz. Levels do not
    show shapes: a measurement with the hole covered, where A0 is gone, tells more.

    freq : (n,) Hz, ascending.
    level_db : (n,) level of each.
    """
    f, level = np.asarray(freq, dtype=np.float64), np.asarray(level_db, dtype=np.float64)
    sure = level > level.max(initial=-np.inf) - _WEAK
    air = np.flatnonzero(sure & (f >= _AIR[0]) & (f <= _AIR[1]))
    if not len(air):
        return {}
    out = {"A0": int(air[0])}
    for name, below, (low, high) in (("T1", "A0", _FIRST), ("T2", "T1", _SECOND)):
        first = f[out[below]]
        near = np.flatnonzero(sure & (f > low * first) & (f < high * first))
        if not len(near):
            break
        out[name] = int(near[level[near] > level[near].max() - _BESIDE][0])
    return out
