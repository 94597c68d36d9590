"""Plates whose values are worked out by hand."""

from __future__ import annotations

import numpy as np

from tonewood.physics.plate.wood import SPECIES

SPRUCE = SPECIES["sitka_spruce"].wood


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
