"""Reprs of the larger objects: one short line."""

from __future__ import annotations

import pytest

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(tw.load_instrument("classical_guitar"), 48000)


def test_each_is_one_short_line(model: Model) -> None:
    score = tw.Score([tw.Note(0.0, 0.1, note=45)] * 1000)
    basis = model.system.compiled[model.system.slot("body")].basis
    audio = tw.render(tw.Score([tw.Note(0.0, 0.1, note=45)]), tw.load_instrument("monochord"), max_duration=0.2)
    for thing in (model, model.system, model.instrument, basis, basis.select([]), score, audio):
        assert len(repr(thing)) < 200, repr(thing)
        assert repr(thing).startswith(type(thing).__name__ + "(")
        assert "\n" not in repr(thing)


def test_they_tell_what_counts(model: Model) -> None:
    assert repr(model) == f"Model('classical_guitar', 6 strings, {model.n_modes} modes, 48000 Hz)"
    assert "1 notes, 0 controls, 1.5 s" in repr(tw.Score([tw.Note(1.0, 0.5, note=60)]))
