"""All strings on the body at once, against the eigenproblem of the whole and a closed form."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from system_modes import CoupledModes, coupled_modes
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection import mounted
from tonewood.instrument.inspection.frequencies import pitch
from tonewood.instrument.inspection.mounted import Mounted
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Ports, Star

Make = Callable[..., Instrument]


def whole(model: Model, string: str, stop: int) -> CoupledModes:
    """The dense eigenproblem: one string stopped, the others open, every polarization on the body."""
    components = {"body": model.system.compiled[0].basis}
    for name, held in model.strings.items():
        components |= held.bases(stop if name == string else 0)
    return coupled_modes(components, [c for c in model.system.connections if c.role == "bridge"])


@pytest.mark.parametrize(("string", "stop"), [("A2", 5), ("A2", 0), ("A2", 12), ("D3", 7), ("D3", 2)])
def test_modes_are_those_of_the_whole_system(make: Make, string: str, stop: int) -> None:
    """Every mode with a tenth of the string in it is found, with its share, where the eigenproblem has it."""
    model = assemble(make(), 16000.0)
    at = pitch(model, string, stop)
    found = Mounted(model.strings, model.system.compiled[0].basis).pitch(at)
    dense = whole(model, string, stop)
    off = 1200 * np.log2(dense.freq / at.wanted_freq)
    share = dense.shares[:, dense.components.index(f"{string}.z")]
    wanted = [(c, x) for c, x in zip(off, share, strict=True) if abs(c) < 60 and x > 0.11]
    assert len(wanted) >= 1
    for c, x in wanted:
        assert min(abs(c - mine) + 100 * abs(x - part) for mine, part in found.modes) < 0.1
    assert found.error_cents == pytest.approx(max(wanted, key=lambda pair: pair[1])[0], abs=0.01)


def test_a_shared_partial_is_named_and_both_figures_stand(make: Make) -> None:
    """A2 stop 5 is D3: in tune alone, off with D3 beside it; without the other string nothing changes."""
    model = assemble(make(), 16000.0)
    body = model.system.compiled[0].basis
    at = pitch(model, "A2", 5)
    together = Mounted(model.strings, body).pitch(at)
    assert abs(at.error_cents) < 0.01
    assert abs(together.error_cents) > 1.0
    assert together.partner == "D3"
    assert together.partner_share > 0.2
    alone = Mounted({"A2": model.strings["A2"]}, body).pitch(at)
    assert alone.error_cents == pytest.approx(at.error_cents, abs=1e-6)
    assert alone.partner is None
    apart = Mounted(model.strings, body).pitch(pitch(model, "A2", 3))
    assert apart.partner is None


def test_two_like_strings_on_one_bridge(make: Make) -> None:
    """Against each other they leave the bridge at rest: one mode is that of a rigid end, k = n pi / L."""
    length, tension, density, bending = 0.65, 71.2, 1.95e-3, 4e-5
    string = make().resonators["D3"].basis(15000.0, tension=tension)
    body = ModalBasis.real([2 * np.pi * 220.0], [2.0], {"bridge": [1.0]}, modal_mass=0.1)
    bridge = np.eye(len(string.points))[[string.index("bridge")]]
    star = Star(Ports.of(body, np.ones((2, 1))), [Ports.of(string, bridge)] * 2)
    for n in (1, 2, 3):
        k = n * np.pi / length
        held = np.sqrt((tension * k**2 + bending * k**4) / density) / (2 * np.pi)
        zeros = star.zeros_within(2j * np.pi * held, 2 * np.pi * held * 0.1)
        assert len(zeros) == 2
        assert min(abs(s.imag / (2 * np.pi * held) - 1) for s in zeros) < 1e-6
        assert max(abs(s.imag / (2 * np.pi * held) - 1) for s in zeros) > 1e-4


def test_a_damped_string_stands_beside_those_of_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """C and D have dampers, and D and E one key; the others stand beside all that have none."""

    class Fake:
        def __init__(self, strings: Any, body: str):
            self.strings = (body, *strings)

        def pitch(self, at: Any) -> Any:
            return at.string, self.strings

    monkeypatch.setattr(mounted, "Mounted", Fake)
    dampers, groups = {"A": None, "B": None, "C": "felt", "D": "felt", "E": None}, {"D": ("D", "E")}
    strings = {
        name: SimpleNamespace(places=SimpleNamespace(damper=damper), group=groups.get(name, (name,)))
        for name, damper in dampers.items()
    }
    model: Any = SimpleNamespace(strings=strings, body="body")
    alone: Any = [SimpleNamespace(string=name) for name in strings]
    free = ("body", "A", "B", "E")
    assert mounted.mounted_pitches(model, alone) == [
        ("A", free), ("B", free), ("C", ("body", "C")), ("D", ("body", "D", "E")), ("E", free),
    ]  # fmt: skip


def test_a_string_that_does_not_end_on_the_body_keeps_its_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    still = [SimpleNamespace(right=np.zeros((1, 3)))]
    monkeypatch.setattr(mounted, "_ports", lambda string, stop: still)
    monkeypatch.setattr(mounted, "Star", lambda *words: pytest.fail("nothing is shared"))
    strings: Any = {"A": SimpleNamespace(polarizations=[])}
    monkeypatch.setattr(mounted.Mounted, "__init__", lambda self, strings, body: None)
    on_body = mounted.Mounted(strings, None)  # type: ignore[arg-type]
    on_body.strings, on_body._open = strings, {}
    freq = 220.0 * 2 ** (3 / 1200)
    mode = SimpleNamespace(pole=complex(-1.0, 2 * np.pi * freq))
    found = on_body.pitch(SimpleNamespace(string="A", stop=2, wanted_freq=220.0, modes=[mode]))  # type: ignore[arg-type]
    assert (found.freq, found.error_cents) == pytest.approx((freq, 3.0))
    assert (found.modes, found.partner, found.partner_share) == (((pytest.approx(3.0), 1.0),), None, 0.0)
