"""Figures of `check` and `modes`, against the eigenproblem of the whole system and closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from system_modes import coupled_modes
from tonewood.instrument.inspection.frequencies import (
    bridge_mobility,
    check_transfers,
    microphone_responses,
    mobility_peaks,
    partials,
    pitch,
    pitches,
)
from tonewood.instrument.inspection.potentials_at_rest import touched_at_rest
from tonewood.instrument.model.assembly import Model, assemble


@pytest.fixture(scope="module")
def monochord() -> Model:
    return assemble(tw.load_instrument("monochord"), 48000)


def on_a_box(folder: Path, body: str) -> Model:
    """The monochord with modes `body`: lines of f_Hz, Q, modal_mass, bridge."""
    original = tw.list_instruments()["monochord"]
    (folder / "instrument.yaml").write_text((original / "instrument.yaml").read_text())
    (folder / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n" + body)
    return assemble(tw.load_instrument(folder), 48000)


@pytest.mark.parametrize("stop", [12])
def test_partials_are_modes_of_the_whole_system(monochord: Model, stop: int) -> None:
    string = monochord.strings["A2"]
    components = {"body": monochord.system.compiled[monochord.system.slot("body")].basis, **string.bases(stop)}
    joints = [c for c in monochord.system.connections if c.role == "bridge"]
    whole = coupled_modes(components, joints)
    found = partials(monochord, "A2", stop, count=10)
    assert [p.number for p in found] == list(range(1, 11))
    of_string = whole.dominated_by("A2.z")  # the other polarization has modes near by
    for p in found:
        nearest = of_string[np.argmin(np.abs(whole.freq[of_string] - p.freq))]
        assert p.freq == pytest.approx(whole.freq[nearest], rel=1e-6)
        assert p.t60 == pytest.approx(np.log(1000) / whole.damping_rate[nearest], rel=1e-4)
        body = whole.shares[nearest, whole.components.index("body")]
        assert p.shares[-1] == pytest.approx(body, abs=1e-4)
        assert sum(p.shares) == pytest.approx(1.0)


def test_pitches_are_those_of_equal_temperament(monochord: Model) -> None:
    found = pitches(monochord)
    assert [p.stop for p in found] == list(range(25))
    for p in found:
        assert p.wanted_freq == pytest.approx(110.0 * 2 ** (p.stop / 12))
        assert abs(p.error_cents) < 1e-2 or p.wolf is not None
        assert p.note == 45 + p.stop


def test_untuned_strings_are_reported_as_they_are() -> None:
    loose = tw.load_instrument("monochord").replace({"tuning.compensate": "none", "strings.A2.tension": 60.0})
    found = pitch(assemble(loose, 48000), "A2")
    assert found.tension == 60.0
    ideal = np.sqrt(60.0 / 1.5e-3) / 1.8
    assert found.freq == pytest.approx(ideal, rel=5e-3)
    assert found.error_cents == pytest.approx(1200 * np.log2(found.freq / 110.0))


def test_a_strong_mode_of_the_body_near_a_note_is_a_wolf(tmp_path: Path) -> None:
    light = on_a_box(tmp_path, "226.0,60,0.02,1\n")
    wolves = {p.stop: p for p in pitches(light) if p.wolf is not None}
    assert 12 in wolves  # A3, 220 Hz
    assert wolves[12].wolf is not None
    assert abs(1200 * np.log2(wolves[12].wolf.freq / wolves[12].freq)) <= 60 or abs(wolves[12].error_cents) > 1
    assert not {0, 1, 2, 19, 20, 21, 22, 23, 24} & set(wolves)


def test_a_heavy_body_has_no_wolves(tmp_path: Path) -> None:
    heavy = on_a_box(tmp_path, "226.0,60,50.0,1\n")
    assert [p for p in pitches(heavy) if p.wolf is not None] == []
    assert max(abs(p.error_cents) for p in pitches(heavy)) < 1e-2


def test_bridge_mobility_is_the_sum_over_the_table(tmp_path: Path) -> None:
    """Y = sum i w (1/m) / (w_k^2 + i w w_k / Q - w^2)."""
    model = on_a_box(tmp_path, "150,30,0.4,1\n410,25,0.2,0.7\n")
    freq = np.array([80.0, 150.0, 300.0, 411.0, 1000.0])
    w = 2 * np.pi * freq
    wanted = np.zeros(5, dtype=complex)
    for f, q, m, phi in ((150.0, 30.0, 0.4, 1.0), (410.0, 25.0, 0.2, 0.7)):
        wk = 2 * np.pi * f
        wanted += 1j * w * phi**2 / m / (wk**2 + 1j * w * wk / q - w**2)
    assert np.allclose(bridge_mobility(model, freq)["A2"], wanted, rtol=1e-10, atol=0)

    peaks = mobility_peaks(model, "A2")
    assert [f for f, _ in peaks] == pytest.approx([150.0, 410.0], rel=5e-3)
    assert peaks[0][1] == pytest.approx(30.0 / (2 * np.pi * 150.0 * 0.4), rel=5e-3)  # Q / (w m)


@pytest.mark.parametrize("note", ["E2", "E3", "A3"])
def test_partials_have_their_numbers_however_far_the_note_is(note: str) -> None:
    """Without compensation the string is the same whatever it is called; cents count from the note."""
    plain = tw.load_instrument("monochord").replace({"tuning.compensate": "none"})
    true = partials(assemble(plain, 48000), "A2", count=6)
    called = assemble(plain.replace({"strings.A2.note": note}), 48000)
    found = partials(called, "A2", count=6)
    assert [p.number for p in found] == [1, 2, 3, 4, 5, 6]
    assert [p.freq for p in found] == pytest.approx([p.freq for p in true], rel=1e-9)
    shift = 1200 * np.log2(110.0 / called.strings["A2"].freq(0))
    assert [p.cents for p in found] == pytest.approx([p.cents + shift for p in true], abs=1e-6)
    assert pitch(called, "A2").freq == pytest.approx(true[0].freq, rel=1e-9)


def test_partials_of_a_string_under_a_soft_finger_are_those_of_its_stop() -> None:
    slide = tw.load_instrument("monochord").replace({"stops.model": "finger"})
    model = assemble(slide, 48000)
    found = partials(model, "A2", 7, count=4)
    assert [p.number for p in found] == [1, 2, 3, 4]
    assert all(abs(p.cents) < 30 for p in found)


def test_microphones_are_found_at_their_peak(tmp_path: Path) -> None:
    """One pole pair, driven by one string: |R / (jw - p) + R / (jw - p*)| is largest near the pole's frequency."""
    original = tw.list_instruments()["monochord"]
    text = (original / "instrument.yaml").read_text()
    text = text.replace("bridge: {direction: z}", "bridge: {direction: z, u: 0.0}")
    text += "  - {name: air, plugin: modal_radiation, table: air.csv, channels: [left, right], full_scale: 1.0}\n"
    (tmp_path / "instrument.yaml").write_text(text)
    (tmp_path / "body.csv").write_bytes((original / "body.csv").read_bytes())
    head = ",".join(f"{c}{m}_{x}" for c in ("left", "right") for m in ("", "_moment") for x in ("re", "im"))
    (tmp_path / "air.csv").write_text(f"f_Hz,Q,{head}\n200,20,30,0,0,0,0,0,0,0\n")
    left, right = microphone_responses(assemble(tw.load_instrument(tmp_path), 48000, outputs=["air"]))
    p = np.complex128(np.pi * 200.0 * (-1 / 20 + 2j))
    freq = np.linspace(190.0, 210.0, 20001)
    expected = np.abs(30 / (2j * np.pi * freq - p) + 30 / (2j * np.pi * freq - p.conj()))
    assert left.peak == pytest.approx(expected.max(), rel=1e-3)
    assert left.freq == pytest.approx(freq[np.argmax(expected)], abs=0.3)
    assert (right.channel, right.peak, np.isnan(right.freq)) == ("right", 0.0, True)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda D, V: (D[:-1], V), "transfer: displacement has shape"),
        (lambda D, V: (D, V * np.nan), "transfer: velocity holds numbers that are not finite"),
        (lambda D, V: (0.5 * D, V), "the string's end at the bridge moves"),
    ],
)
def test_broken_transfers_are_named(monkeypatch: pytest.MonkeyPatch, change: Any, reason: str) -> None:
    model = assemble(tw.load_instrument("monochord"), 24000)
    check_transfers(model)
    kind = type(model.strings["A2"].resonator)
    transfer = kind.transfer
    monkeypatch.setattr(kind, "transfer", lambda self, old, new: change(*transfer(self, old, new)))
    with pytest.raises(tw.errors.BundleError, match=rf"strings\.A2: .*{reason}"):
        check_transfers(model)


THREAD = {"plugin": "bridge_barrier", "start": 1e-3, "stop": 5e-3, "below": 1e-3, "stiffness": 1e6, "points": 1}
SPRING = {"from_bridge": 0.01, "stiffness": 2e3, "damping": 0.0, "points": 1}


@pytest.mark.parametrize(
    ("part", "touches"),
    [
        (THREAD, False),  # one millimetre below the string
        (THREAD | {"below": 0.0}, True),  # its only point lies at the string
        (THREAD | {"thread": SPRING}, True),
        (THREAD | {"thread": SPRING | {"stiffness": 0.0}}, False),
        (THREAD | {"thread": SPRING | {"stiffness": 0.0, "damping": 0.1}}, True),
        ({"plugin": "listing", "from_bridge": 0.5, "width": 0.02, "damping": 1.0}, True),
        ({"plugin": "rattle", "from_bridge": 0.3, "mass": 1e-3, "clearance": 1e-4}, False),
    ],
)
def test_parts_that_hold_or_damp_a_resting_string_are_named(part: dict[str, Any], touches: bool) -> None:
    touched = tw.load_instrument("monochord").replace({"connections": {"part": part}})
    assert touched_at_rest(assemble(touched, 48000)) == ({"part": ["A2"]} if touches else {})
