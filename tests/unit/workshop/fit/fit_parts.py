"""Responses of fits whose values are worked out by hand."""

from __future__ import annotations

import numpy as np
from fit_scenes import TAU

from tonewood.workshop.fit.projection import Shape

FREQ = np.arange(60.0, 801.0)


REAL = Shape((0,), 2, False, False, False)


def resonances(freq, at, quality, alpha=0.0):
    s, w = alpha + 1j * TAU * np.asarray(freq), TAU * np.asarray(at, float)[:, None]
    return s / (s * s + w / np.asarray(quality, float)[:, None] * s + w * w)
