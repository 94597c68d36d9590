"""Instruments that are made once, and MIDI ports of this process."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tonewood as tw


@pytest.fixture(scope="session")
def guitar() -> tw.Instrument:
    return tw.load_instrument("classical_guitar")


@pytest.fixture(scope="session")
def monochord() -> tw.Instrument:
    return tw.load_instrument("monochord")


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """The backend, in place of that of the machine."""
    import mido

    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    before = mido.backend
    mido.set_backend("midi_backend")
    import midi_backend

    yield midi_backend
    mido.set_backend(before)
    sys.modules.pop("midi_backend", None)
