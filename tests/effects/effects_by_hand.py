"""A model and its state for effects whose values are worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import (
    Moment,
)
from tonewood.performance.player.fretting import Fretting
from tonewood.physics.coupling.system import State


def shaken(model: Model, seed: int, size: float = 1e-6) -> State:
    """Random motion of all modes, weaker the higher they are."""
    rng, state = np.random.default_rng(seed), model.system.start()
    for name in model.system.names:
        modes = model.system.modes_of(state, name)
        modes[:] = rng.normal(size=modes.shape) * size / np.arange(1, modes.shape[1] + 1)
    return state


def replace_moment(model: Model, frettings: dict[str, Fretting], sample: int = 0, **more: Any) -> Moment:
    held = {name: Fretting() for name in model.strings} | frettings
    state = more.pop("state", None) or model.system.start()
    state.sample = sample
    return Moment(model.system, state, held, np.ones(len(model.system.readouts)), **more)
