"""Bases that change from one call to the next: a plugin whose results depend on more than its arguments."""

from __future__ import annotations

import numpy as np

from tonewood.instrument.model.assembly import Model
from tonewood.physics.modal.modes import ModalBasis


def changing_bases(model: Model) -> list[str]:
    """Return ``body`` and names of strings whose plugins give another basis when they are asked for it again."""
    body = model.instrument.body
    out = [] if _same(*(body.basis(model.fs / 2) for _ in range(2))) else ["body"]
    for name in model.groups:
        string = model.strings[name]
        freq_upper, tension = string.tuning.untuned.freq_upper, string.tension(0)
        if not _same(*(string.resonator.basis(freq_upper, tension=tension) for _ in range(2))):
            out.append(name)
    return out


def _same(one: ModalBasis, other: ModalBasis) -> bool:
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("poles", "right", "left", "residual")]
    return one.points == other.points and all(np.array_equal(a, b) for a, b in pairs)
