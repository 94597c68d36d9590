"""A string with longitudinal motion, as a bundle's part: with gestures, contacts, stops, a body, and left out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scene import PLUCK, instrument, play

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

Floats = NDArray[np.float64]

#: plain steel, .305 mm
STEEL: dict[str, Any] = {
    "plugin": "geometric_string",
    "note": "E4",
    "length": 0.645,
    "tension": 104.1,
    "linear_density": 5.757e-4,
    "bending_stiffness": 8.5e-5,
    "axial_stiffness": 14612.0,
    "freq_coupled": 3000.0,
    "loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4},
    "polarizations": ["z", "y"],
}
GESTURES: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "pluck": ({**PLUCK, "ramp_time": 0.004}, {"force": 8.0}),
    "plectrum": ({"plugin": "plectrum", "from_bridge": 0.12}, {"force": 3.0}),
    "hammer": ({"plugin": "hammer", "from_bridge": 0.1, "mass": 5e-3, "stiffness": 1e7, "exponent": 2.5},
               {"velocity": 2.0}),
    "bow": ({"plugin": "bow", "from_bridge": 0.08, "force": 1.0, "speed": 0.1}, {"velocity": 0.3}),
    "finger": ({"plugin": "stopping_finger", "touch": 0.01, "lift": 0.02, "from_bridge": 0.2}, {"force": 5.0}),
}  # fmt: skip
PARTS: dict[str, dict[str, Any]] = {
    "frets": {"plugin": "frets", "action_first": 3e-4, "action_twelfth": 8e-4, "stiffness": 1e7, "exponent": 1.5},
    "fingerboard": {"plugin": "fingerboard", "end_from_bridge": 0.2, "action_nut": 1e-4, "action_end": 1e-4,
                    "points": 8, "stiffness": 3e6, "exponent": 2.3, "loss": 0.5},
    "bridge": {"plugin": "bridge_barrier", "start": 0.0, "stop": 0.01, "radius": 0.5, "stiffness": 1e8, "points": 6},
    "rattle": {"plugin": "rattle", "from_bridge": 0.3, "mass": 2e-3, "clearance": 1e-5, "stiffness": 3e6,
               "exponent": 2.3},
}  # fmt: skip


def made(folder: Path, gesture: str = "pluck", part: str | None = None, **string: Any) -> Instrument:
    more: dict[str, Any] = {"exciters": {"it": GESTURES[gesture][0]}}
    if part:
        more["connections"] = {part: PARTS[part]}
    if part == "frets":
        more["stops"] = {"kind": "frets", "count": 14}
    return instrument(folder, {**STEEL, **string}, **more)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gesture", "part"), [(g, None) for g in GESTURES] + [("pluck", p) for p in PARTS], ids=lambda x: str(x)
)
def test_kernel_and_twin_agree_whatever_touches_it(tmp_path: Path, gesture: str, part: str | None) -> None:
    whole = made(tmp_path, gesture, part)
    values, length = GESTURES[gesture][1], 0.0015
    runs = [
        play(whole, values, duration=length, exciter="it", fs=24000, stepper=stepper)
        for stepper in (KernelStepper, NumpyStepper)
    ]
    for name, force in runs[1].forces.items():
        scale = np.abs(force).max()
        np.testing.assert_allclose(runs[0].forces[name], force, atol=1e-7 * scale + 1e-12, err_msg=name)
    np.testing.assert_allclose(runs[0].out, runs[1].out, atol=1e-9 * np.abs(runs[1].out).max())
    assert any("longitudinal" in name and np.abs(f).max() > 0 for name, f in runs[0].forces.items())


@pytest.mark.parametrize(("gesture", "part"), [("pluck", None), ("pluck", "frets"), ("hammer", None), ("bow", None)])
def test_the_energy_budget_closes(tmp_path: Path, gesture: str, part: str | None) -> None:
    played = play(
        made(tmp_path, gesture, part), GESTURES[gesture][1], duration=0.006, exciter="it", fs=24000, energy=True
    )
    assert played.energy is not None
    assert played.energy.worst_residual < 1e-9


def guitar(folder: Path, **string: Any) -> Instrument:
    """The string on a light plate of one mode, heard by the plate's velocity."""
    (folder / "plate.csv").write_text("f_Hz,Q,modal_mass,bridge\n180,20,0.1,1\n")
    body = {"plugin": "modal_table", "table": "plate.csv", "shapes": "points", "points": {"bridge": {"direction": "z"}}}
    heard = [{"name": "plate", "plugin": "point_pickup", "quantity": "velocity", "at": "body.bridge", "full_scale": 1}]
    return instrument(folder, {**STEEL, "polarizations": ["z"], **string}, body=body, outputs=heard)


def level(signal: Floats, freq: float, fs: float = 48000) -> float:
    """Of the strongest line within 10 Hz, dB, under a Blackman-Harris window."""
    t = 2 * np.pi * np.arange(len(signal)) / len(signal)
    window = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    spectrum, grid = np.abs(np.fft.rfft(window * signal)), np.fft.rfftfreq(len(signal), 1 / fs)
    return float(20 * np.log10(spectrum[np.abs(grid - freq) < 10].max()))


def test_phantom_partials_are_heard_through_the_bridge(tmp_path: Path) -> None:
    """Near the first longitudinal mode, 3.9 kHz, lines at f_m + f_n that no transverse partial explains."""
    mu, T, L, EI = STEEL["linear_density"], STEEL["tension"], STEEL["length"], 3e-3
    n = np.arange(1, 20)
    partial = n / (2 * L) * np.sqrt(T / mu) * np.sqrt(1 + EI * np.pi**2 / (T * L**2) * n**2)
    # bending stiffness sets the sums of neighbours apart from the partial whose number is the same
    pairs = (5, 6, 7)
    sums = [partial[m - 1] + partial[m] for m in pairs]
    assert min(abs(partial[2 * m] - f) for m, f in zip(pairs, sums, strict=True)) > 50
    sound = {
        leverage: play(
            guitar(tmp_path, bridge_leverage=leverage, bending_stiffness=EI), {"force": 6.0}, duration=0.4
        ).out[-16384:]
        for leverage in (0.0, 0.3)
    }
    for f in sums:
        assert level(sound[0.3], f) > level(sound[0.0], f) + 6


def test_what_is_left_out_is_left_out(tmp_path: Path) -> None:
    whole = made(tmp_path)
    model = assemble(whole, 48000)
    assert [type(p) for p in model.system.potentials] == [GeometricStretch]
    assert "S.longitudinal.bridge" in [c.name for c in model.system.connections]
    rising = assemble(whole.replace({"effects.mode": ["tension_modulation", "second_polarization"]}), 48000)
    assert [type(p) for p in rising.system.potentials] == [TensionModulation]
    plain = assemble(whole.replace({"effects.mode": "none"}), 48000)
    assert not plain.system.potentials
    assert plain.strings["S"].components == ("S.z",)


def test_the_end_moves_along_an_inclined_string_as_the_body_does(tmp_path: Path) -> None:
    slope = math.radians(23.6)
    axis = [math.cos(slope), 0.0, -math.sin(slope)]
    harp = made(tmp_path, axis=axis, polarizations=["z"], bridge_leverage=0.0)
    string = assemble(harp, 48000).strings["S"]
    assert string.longitudinal is not None
    assert string.longitudinal.ends["bridge"] == pytest.approx(math.sin(slope))
    assert string.polarizations[0].ends["bridge"] == pytest.approx(math.cos(slope))
    lever = assemble(harp.replace({"strings.S.bridge_leverage": 0.2}), 48000).strings["S"]
    assert lever.longitudinal is not None
    assert lever.longitudinal.ends["bridge"] == pytest.approx(math.sin(slope) + 0.2)


def test_what_is_not_offered_is_refused_in_one_line(tmp_path: Path) -> None:
    short = made(tmp_path, axial_stiffness=14612.0, linear_density=5e-5, tension=9.0, length=0.3, note="E4")
    with pytest.raises(BundleError, match=r"S\.axial_stiffness: has no longitudinal mode below 10800 Hz"):
        assemble(short.replace({"strings.S.axial_stiffness": 1e5}), 24000)


@pytest.mark.slow
def test_a_guitar_of_such_strings_is_stopped_bent_and_damped() -> None:
    guitar = tw.load_instrument("steel_strings").replace({"strings.*.plugin": "geometric_string"})
    notes = (
        tw.Note(0.03, 0.05, string="G3", stop=4, velocity_midi=110),
        tw.Note(0.06, 0.04, string="G3", stop=7, velocity_midi=100, technique="hammer_on"),
        tw.Note(0.08, 0.04, string="E4", stop=0, velocity_midi=120),
    )
    score = tw.Score(notes)
    renderer = tw.Renderer(score, guitar, 48000, max_duration=0.14)
    sound = np.concatenate(list(renderer.blocks()))
    assert np.all(np.isfinite(sound))
    assert np.abs(sound).max() > 0.01
    other = tw.Renderer(score, guitar, 48000, max_duration=0.14)
    np.testing.assert_array_equal(np.concatenate(list(other.blocks(100))), sound)
