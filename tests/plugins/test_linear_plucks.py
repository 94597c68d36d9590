"""Plucks with `linear`: twice the force is twice the sound, and the sound of several notes is the sum of theirs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import instrument

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument

FINGER = {"plugin": "finger_pluck", "from_bridge": 0.1}
RAMP = {"plugin": "pluck_ramp", "from_bridge": 0.1}


def two_strings(
    folder: Path, pluck: dict[str, Any], stops: dict[str, Any] | None = None, **exciters: dict[str, Any]
) -> Instrument:
    """Two strings a fifth apart on one soft mode, so that each moves the other."""
    string = {
        "plugin": "stiff_string", "note": "A2", "length": 0.65, "tension": 73.9, "linear_density": 3.61e-3,
        "loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4}, "end": "body.bridge", "split_cents": 2.0,
    }  # fmt: skip
    played = instrument(
        folder,
        strings={"S": string, "T": {**string, "note": "E3", "linear_density": 1.6e-3}},
        exciters={"pluck": pluck, **exciters},
        **({} if stops is None else {"stops": stops}),
        playing={"velocity": {"parameter": "pluck.force", "low": 0.1, "high": 5.0}},
        tuning={},
    )
    (folder / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n221,25,0.05,1\n")
    return played


def sound(played: Instrument, notes: Sequence[tw.Note], effects: str = "all") -> np.ndarray:
    options = {"max_duration": 0.6, "tail_level_db": -299.0, "effects": effects}
    stream = tw.Renderer(tw.Score(notes), played, fs=24000, **options)
    return np.concatenate(list(stream.blocks())).astype(np.float64)


def notes(factor: float = 1.0) -> list[tw.Note]:
    """Two strings, one of them twice, at other places."""
    return [
        tw.Note(0.0, 1.0, string="S", stop=0, force=factor * 1.7),
        tw.Note(0.15, 1.0, string="T", stop=0, force=factor * 0.4, from_bridge=0.2),
        tw.Note(0.33, 1.0, string="S", stop=0, force=factor * 3.1, from_bridge=0.05),
    ]


def level(error: np.ndarray, of: np.ndarray) -> float:
    """Of the largest error, dB re the largest sample."""
    return float(20 * np.log10(max(np.abs(error).max(), 1e-30) / np.abs(of).max()))


@pytest.mark.slow
@pytest.mark.parametrize("effects", ["all", "auto"])
@pytest.mark.parametrize("pluck", [FINGER, RAMP, {**FINGER, "nail": 0.0, "roughness": 0.1}], ids=lambda p: str(len(p)))
def test_notes_scale_and_superpose(tmp_path: Path, pluck: dict[str, Any], effects: str) -> None:
    played = two_strings(tmp_path, {**pluck, "linear": True})
    together = sound(played, notes(), effects)
    assert np.array_equal(sound(played, notes(2.0), effects), 2 * together)
    assert level(sound(played, notes(0.3), effects) - 0.3 * together, together) < -240.0
    assert level(sum(sound(played, [note], effects) for note in notes()) - together, together) < -240.0


COURSES = {
    "stops": [
        ("S", 0.0, 0.12, 0.0, None),
        ("S", 0.12, 0.2, 5.0, None),
        ("T", 0.2, 0.3, 2.0, None),
        ("S", 0.32, 0.2, 3, None),
    ],
    "fractions": [("S", 0.0, 0.2, 1.5, None), ("T", 0.1, 0.4, 0.25, None), ("S", 0.25, 0.3, 6.75, None)],
    "slides": [("S", 0.0, 0.2, 2.5, None), ("S", 0.2, 0.2, 7.25, "slide"), ("S", 0.42, 0.2, 0.5, "slide")],
}


@pytest.mark.parametrize(
    "course", [pytest.param(c, marks=[pytest.mark.slow] if c in ("fractions", "slides") else []) for c in COURSES]
)
@pytest.mark.parametrize(
    "pluck", [pytest.param(FINGER, id="finger"), pytest.param(RAMP, id="ramp", marks=pytest.mark.slow)]
)
def test_under_one_course_of_stops_they_scale_and_superpose(tmp_path: Path, pluck: dict[str, Any], course: str) -> None:
    """A change of stop acts on all that sounds, and depends on no force: a note of force 0 keeps its stop alone."""
    played = two_strings(
        tmp_path, {**pluck, "linear": True}, stops={"kind": "continuous", "count": 12},
        slide={"plugin": "left_hand", "action": "slide", "time": 0.1},
    )  # fmt: skip
    rows = COURSES[course]
    forces = [1.7, 0.4, 3.1, 0.9][: len(rows)]

    def heard(factors: Sequence[float]) -> np.ndarray:
        return sound(played, [
            tw.Note(time, duration, string=string, stop=stop, technique=technique, force=force * factor)
            for (string, time, duration, stop, technique), force, factor in zip(rows, forces, factors, strict=True)
        ])  # fmt: skip

    ones = [1.0] * len(forces)
    together = heard(ones)
    assert level(heard([0.3 * one for one in ones]) - 0.3 * together, together) < -200.0
    parts = [heard([float(i == j) for j in range(len(forces))]) for i in range(len(forces))]
    assert level(sum(parts) - together, together) < -200.0
    # each for itself, the string is held elsewhere: another sound
    alone = sum(
        sound(played, [tw.Note(t, d, string=name, stop=stop, technique=technique, force=force)])
        for (name, t, d, stop, technique), force in zip(rows, forces, strict=True)
        if technique is None
    )
    assert level(alone - together, together) > -40.0


def test_without_it_they_do_not(tmp_path: Path) -> None:
    """The release depends on the force, and a finger damps earlier motion of its string."""
    finger = two_strings(tmp_path, FINGER)
    together = sound(finger, notes())
    assert level(sound(finger, notes(2.0)) - 2 * together, together) > -40.0
    for pluck in (FINGER, RAMP):
        played = two_strings(tmp_path, pluck)
        together = sound(played, notes())
        assert level(sum(sound(played, [note]) for note in notes()) - together, together) > -40.0


def test_the_bundle_s_own_force_is_plucked_alike(tmp_path: Path) -> None:
    """At that force `linear` only takes the finger's dashpot away."""
    own = [tw.Note(0.0, 1.0, string="S", stop=0, force=2.0)]
    linear = sound(two_strings(tmp_path, {**FINGER, "linear": True}), own)
    assert np.array_equal(sound(two_strings(tmp_path, {**FINGER, "hold_dashpot": 0.0}), own), linear)


def test_a_bundle_without_a_force_is_refused(tmp_path: Path) -> None:
    played = two_strings(tmp_path, {**FINGER, "linear": True, "force": 0.0})
    with pytest.raises(
        BundleError, match=r"exciters\.pluck\.linear: needs `force` above 0 N, .*; exciters\.pluck\.force is 0 N"
    ):
        sound(played, notes())


def test_a_guitar_of_measured_modes_superposes_at_once() -> None:
    """The built-in guitar, whose key is changed as on the command line."""
    guitar = tw.load_instrument("classical_guitar").replace({"exciters.pluck.linear": True})
    apart = [tw.Note(0.0, 1.0, string="E2", stop=0, force=1.0), tw.Note(0.1, 1.0, string="G3", stop=0, force=2.0)]
    together = sound(guitar, apart)
    assert level(sum(sound(guitar, [note]) for note in apart) - together, together) < -240.0
