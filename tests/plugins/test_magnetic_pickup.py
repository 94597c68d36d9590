"""Magnetic pickups: circuit, flux, aperture, and the notes of the bass that hears by them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tonewood.plugins.magnetic_pickup import MagneticPickup, induced

import tonewood as tw
from tonewood.authoring import Conversion, assemble, wavenumber
from tonewood.errors import TonewoodError
from tonewood.instrument.contract.conversion import Converter
from tonewood.sound.render.model_file import save_model

FS = 48000
COIL = {"resistance": 7300.0, "inductance": 2.5, "capacitance": 120e-12}
LOAD = {"volume": 250e3, "tone": 250e3, "tone_capacitor": 47e-9, "cable": 500e-12, "input": 1e6}


def pickup(**more: object) -> MagneticPickup:
    return MagneticPickup.from_values({"at": "neck", "coil": COIL, "load": LOAD, "sensitivity": 1.0, **more})


def divider(freq: np.ndarray) -> np.ndarray:
    """The same circuit from its impedances."""
    s = 2j * np.pi * freq
    shunt = 1 / (1 / 250e3 + 1 / 1e6 + s * 620e-12 + 1 / (250e3 + 1 / (s * 47e-9)))
    return shunt / (shunt + 7300.0 + 2.5 * s)


def test_the_circuit_is_a_divider_of_impedances() -> None:
    freq = np.geomspace(20.0, 20000.0, 60)
    np.testing.assert_allclose(pickup().circuit().response(freq), divider(freq), rtol=1e-10)


def test_an_unloaded_coil_resonates_with_its_cable() -> None:
    """2.5 H and 620 pF: 4.04 kHz, lowered by sqrt(1 - 1 / 2 Q^2) with Q = omega L / R = 8.7."""
    free = {**LOAD, "volume": 1e8, "tone_capacitor": 0.0, "input": 1e9}
    freq = np.linspace(3000.0, 5000.0, 4001)
    response = pickup(load=free).circuit().response(freq)
    assert freq[np.argmax(np.abs(response))] == pytest.approx(4042.5 * np.sqrt(1 - 0.5 / 8.7**2), abs=2.0)


def test_the_filter_follows_the_circuit() -> None:
    n = 1 << 14
    impulse = np.zeros((n, 1))
    impulse[0] = 1.0
    response = np.fft.rfft(Converter(Conversion(circuit=pickup().circuit()), 1 / FS, 1)(impulse)[:, 0])
    freq = np.fft.rfftfreq(n, 1 / FS)
    heard = (freq > 20) & (freq < 8000)
    held = np.sinc(freq[heard] / FS) ** 2  # a straight line between samples
    np.testing.assert_allclose(response[heard] / (divider(freq[heard]) * held), 1.0, atol=0.02)


def test_a_filter_in_blocks_is_the_filter_in_one() -> None:
    noise = np.random.default_rng(1).standard_normal((1000, 1))
    whole, blocks = (Converter(Conversion(circuit=pickup().circuit()), 1 / FS, 1) for _ in range(2))
    np.testing.assert_array_equal(
        whole(noise), np.concatenate([blocks(part) for part in np.split(noise, [1, 64, 65, 700])])
    )


def test_voltage_is_the_rate_of_the_flux() -> None:
    """e is d/dt B^2 over its slope at rest, by differences of a motion in both directions."""
    gap, radius, t = 3e-3, 2.4e-3, np.arange(20000) / 2e6
    z, y = 1e-3 * np.sin(2 * np.pi * 150 * t), 7e-4 * np.cos(2 * np.pi * 90 * t)
    vz, vy = 1e-3 * 2 * np.pi * 150 * np.cos(2 * np.pi * 150 * t), -7e-4 * 2 * np.pi * 90 * np.sin(2 * np.pi * 90 * t)
    r = np.hypot(y, gap + z)
    flux = (1 - np.cos(np.arctan2(radius, r))) ** 2  # the face is seen under this angle
    slope = np.diff((1 - np.cos(np.arctan2(radius, gap + np.array([-1e-8, 1e-8])))) ** 2)[0] / 2e-8
    wanted = np.gradient(flux, t) / slope
    got = induced(np.column_stack([vz, vy, z, y]), gap, radius)[:, 0]
    np.testing.assert_allclose(got[1:-1], wanted[1:-1], atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize(("across", "even"), [(True, False), (False, True)])
def test_motion_towards_the_pole_and_along_it(across: bool, even: bool) -> None:
    """Small motion A sin(wt): across, harmonics by the flux's derivatives, F'' A / 2 F'; along, all are even."""
    gap, radius, a, n = 3e-3, 2.4e-3, 2e-5, 4096
    flux = (1 - np.cos(np.arctan2(radius, gap + 1e-5 * np.arange(-2, 3)))) ** 2
    first, second = np.gradient(flux, 1e-5)[2], np.diff(flux, 2)[1] / 1e-10
    phase = 2 * np.pi * np.arange(n) / n
    move, speed, rest = a * np.sin(phase), a * np.cos(phase), np.zeros(n)
    columns = [speed, rest, move, rest] if across else [rest, speed, rest, move]
    spectrum = np.abs(np.fft.rfft(induced(np.column_stack(columns), gap, radius)[:, 0]))[:6]
    if even:
        assert spectrum[1] < 1e-12 * spectrum[2]
        assert spectrum[3] < 1e-9 * spectrum[2]
    else:
        assert spectrum[2] / spectrum[1] == pytest.approx(abs(second / first) * a / 2, rel=1e-3)


def test_a_coil_hears_the_mean_over_its_aperture() -> None:
    """A mode's shape over a width a is that at the middle times sin(ka/2) / (ka/2)."""
    bases = []
    for width in (0.0, 0.012):
        model = assemble(tw.load_instrument("electric_bass").replace({"strings.*.points.neck.width": width}), FS)
        bases.append(model.system.compiled[model.system.slot("A1.z")].basis)
    narrow, wide = bases
    k = wavenumber(2 * np.pi * narrow.natural_freq[:60], 188.2, 20.72e-3, 2.9e-3)
    point = narrow.index("neck")
    a, b = (basis.right[point, :60].real for basis in bases)
    loud = np.abs(a) > 0.3 * np.abs(narrow.right[point].real).max()
    assert loud.sum() > 20
    np.testing.assert_allclose((b / a)[loud], np.sinc(k * 0.012 / (2 * np.pi))[loud], atol=4e-3)
    np.testing.assert_array_equal(narrow.right[narrow.index("bridge")], wide.right[wide.index("bridge")])


def test_a_snapshot_holds_the_circuit() -> None:
    score = tw.Score([tw.Note(0.0, 0.2, string="G2", stop=2, velocity_midi=90)])
    renderer = tw.Renderer(score, "electric_bass", max_duration=0.25, effects="none")
    blocks = renderer.blocks(3000)
    next(blocks)
    kept = renderer.snapshot()
    first = np.concatenate(list(blocks))
    renderer.restore(kept)
    np.testing.assert_array_equal(np.concatenate(list(renderer.blocks(777))), first)


def test_strings_add_up_in_the_coil() -> None:
    """A linear pickup of two strings gives their sum; the rest is a finger's, by the bridge."""
    notes = [tw.Note(0.0, 0.3, string="E1", stop=0, force=1.0), tw.Note(0.0, 0.3, string="G2", stop=5, force=1.0)]
    linear = tw.load_instrument("electric_bass").replace({"outputs.neck.gap": None})
    both, one, other = (
        tw.render(tw.Score(played), linear, max_duration=0.2, effects="none").samples
        for played in (notes, notes[:1], notes[1:])
    )
    assert np.abs(both - one - other).max() < 1e-3 * np.abs(both).max()


@pytest.mark.slow
def test_a_bass_sounds_like_one() -> None:
    """No note below velocity 115 touches a fret; above 3 kHz lies little, on recorded basses some -50 dB."""
    for string, stop in (("E1", 0), ("E1", 4), ("A1", 7), ("D2", 2), ("G2", 12)):
        score = tw.Score([tw.Note(0.0, 0.5, string=string, stop=stop, velocity_midi=110)])
        renderer = tw.Renderer(score, "electric_bass", max_duration=0.5, effects="all")
        samples = np.concatenate(list(renderer.blocks(8192)))[:, 0]
        power = np.abs(np.fft.rfft(samples)) ** 2
        high = power[np.fft.rfftfreq(len(samples), 1 / FS) > 3000].sum() / power.sum()
        assert -65 < 10 * np.log10(high) < -35, (string, stop)
        touched = sum(e.seconds_active for e in renderer.summary().effects if e.name == "frets")
        assert touched == 0, (string, stop)


def test_a_circuit_is_not_saved_for_other_programs(tmp_path: Path) -> None:
    with pytest.raises(TonewoodError, match=r"^outputs: a circuit, .* cannot be saved"):
        save_model(tmp_path / "bass.arrays", "electric_bass")


def test_faults_name_the_key() -> None:
    lost = tw.load_instrument("electric_bass").replace({"outputs.neck.at": "middle"})
    with pytest.raises(TonewoodError, match=r"no string has a point 'middle'; there are .*neck"):
        assemble(lost, FS)
