"""Sound of the engine, measured, against closed forms and the eigenproblem in continuous time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
from sounds import cents, partial
from tonewood.instrument.inspection.frequencies import partials
from tonewood.instrument.model.assembly import assemble

Floats = NDArray[np.float64]


def sound(
    instrument: tw.Instrument, notes: list[tw.Note], duration: float, fs: int = 48000, **options: object
) -> Floats:
    controls = options.pop("controls", ())
    renderer = tw.Renderer(tw.Score(notes, controls), instrument, fs, max_duration=duration, **options)  # type: ignore[arg-type]  # passed on
    return np.concatenate(list(renderer.blocks(8192)))


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    """One polarization, so that every partial is one mode; heard as displacement."""
    made = tw.load_instrument("monochord")
    return made.replace(
        {
            "strings.A2.polarizations": ["z"],
            "outputs.bridge.quantity": "displacement",
            "outputs.bridge.full_scale": 1e-4,
            "exciters.tap": {"plugin": "force_pulse", "at": "body.bridge", "duration": 1e-3, "force": 1.0},
        }
    )


@pytest.mark.parametrize("fs", [22050, 48000, 96000])
def test_pitch_and_decay_are_those_of_the_coupled_modes_at_every_rate(monochord: tw.Instrument, fs: int) -> None:
    x = sound(monochord, [tw.Note(0.0, 5.0, note=45, force=1.0)], 0.9, fs)[round(0.05 * fs) :, 0]
    expected = {p.number: p for p in partials(assemble(monochord, 96000.0), "A2", count=8)}
    for number in (1, 2, 3, 5, 8):
        freq, rate = partial(x, fs, expected[number].freq)
        assert cents(freq, expected[number].freq) == pytest.approx(0.0, abs=0.03)
        assert np.log(1000) / rate == pytest.approx(expected[number].t60, rel=2e-3)
    assert cents(partial(x, fs, 110.0)[0], 110.0) == pytest.approx(0.0, abs=0.05)


def test_a_stop_sounds_its_note(monochord: tw.Instrument) -> None:
    x = sound(monochord, [tw.Note(0.0, 5.0, note=50.5, force=1.0)], 0.8)[2400:, 0]
    wanted = 440.0 * 2 ** ((50.5 - 69) / 12)
    assert cents(partial(x, 48000, wanted)[0], wanted) == pytest.approx(0.0, abs=0.1)


def test_a_bend_turns_the_pitch_by_its_cents_and_keeps_the_string_ringing(monochord: tw.Instrument) -> None:
    notes = [tw.Note(0.0, 5.0, note=45, force=1.0)]
    x = sound(monochord, notes, 1.6, controls=[tw.Control(0.8, "bend", 150.0)])[:, 0]
    before, after = (partial(part, 48000, near)[0] for part, near in ((x[2400:], 110.0), (x[40000:], 120.0)))
    assert cents(after, before) == pytest.approx(150.0, abs=1.5)  # the body's modes do not move along
    assert np.abs(x[40000:48000]).max() > 0.3 * np.abs(x[30000:38000]).max()


def test_tapping_the_body_gives_the_receptance_of_string_and_body_together(monochord: tw.Instrument) -> None:
    """Laplace transforms at s = a + i w of force and displacement, against H_body H_string / (H_body + H_string)."""
    fs = 48000
    model = assemble(monochord, fs)
    x = sound(monochord, [tw.Note(0.0, 1.0, technique="tap", force=1.0)], 1.0)[:, 0] * 1e-4
    bases = {name: c.basis for name, c in zip(model.system.names, model.system.compiled, strict=True)}
    t = np.arange(len(x)) / fs
    for freq in (60.0, 110.0, 187.3, 220.0, 331.0, 1000.0):
        s = 25.0 + 2j * np.pi * freq  # 25 1/s: after one second nothing is left to be cut off

        def receptance(component: str, s: complex = s) -> complex:
            b = bases[component]
            phi = b.right[b.index("bridge")].real  # of unit mass
            modal = np.sum(phi**2 / (s**2 + 2 * b.damping_rate * s + b.stiffness))
            return complex(modal + b.residual[b.index("bridge"), b.index("bridge")])

        h_body, h_string = receptance("body"), receptance("A2.z")
        whole = h_body * h_string / (h_body + h_string)
        # force: two pairs of parabolas, a raised bump of impulse force x duration / 2
        u = np.linspace(0.0, 1e-3, 4001)
        v = u / 1e-3
        rise = np.where(v < 0.25, 8 * v**2, np.where(v < 0.5, 1 - 8 * (0.5 - v) ** 2, 0.0))
        shape = np.where(v < 0.5, rise, np.interp(1 - v, v, rise))
        shape[2000] = 1.0
        force = np.trapezoid(shape * np.exp(-s * u), u)
        found = np.sum(x * np.exp(-s * t)) / fs
        assert abs(found / force - whole) < 1e-4 * abs(whole)
