"""Rows of simulated experiments."""

from __future__ import annotations

import numpy as np

from tonewood.workshop.listening.panel import SimulatedPanel


def rows_of(y: np.ndarray) -> list[dict]:
    """Rows of an array (listeners, levels, repetitions)."""
    return [
        {"listener": str(i), "f": str(j), "value": float(v)}
        for i, own in enumerate(np.atleast_3d(y))
        for j, values in enumerate(own)
        for v in values
    ]


def panel(**changes) -> SimulatedPanel:
    return SimulatedPanel.model_validate({"schema": "tonewood-panel/1", **changes})
