"""Facts of reports against closed forms, a rendered sound, and a caller's changes."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.workshop.report.as_json import to_json
from tonewood.workshop.report.comparison import Candidate, Comparison, alike, compare, match_modes, match_wolves
from tonewood.workshop.report.facts import BodyMode
from tonewood.workshop.report.parameters import flattened, parameters
from tonewood.workshop.report.summary import changes
from tonewood.workshop.report.tones import flac, matched_gains_db

FS = 16000
CHANGES = {"strings.A2.tension": 55.0, "strings.A2.loss.sigma0": 1.2, "tuning.hold": "tension"}


@pytest.fixture(scope="module")
def found() -> Comparison:
    """The monochord, and one with another tension and loss."""
    monochord = tw.load_instrument("monochord")
    both = [Candidate(monochord), Candidate(monochord.replace(CHANGES), ("as said",))]
    return compare(both, notes=["A2"], fs=FS, duration=1.0)


def body_table() -> list[dict[str, float]]:
    text = (tw.list_instruments()["monochord"] / "body.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return [{key: float(value) for key, value in row.items()} for row in rows]


def test_ten_grams_are_seen_everywhere() -> None:
    """The mode at 216.4 Hz of a guitar with 10 g in the middle of its bridge: a peak at 201.1 Hz, a pole beside it."""
    guitar = tw.load_instrument("classical_guitar").replace({"stops.kind": "none"})
    heavy = guitar.replace({"body.added": [{"at": "bridge_middle", "mass": 0.010}]})
    light, loaded = compare([Candidate(guitar), Candidate(heavy)], notes=["E2"], fs=FS, duration=0.2).instruments
    assert min(abs(mode.freq - 216.4) for mode in light.body_modes) < 0.1
    assert min(abs(mode.freq - 201.0) for mode in loaded.body_modes) < 0.2
    assert min(abs(mode.freq - 216.4) for mode in loaded.body_modes) > 5
    for facts, peak in ((light, 216.4), (loaded, 201.1)):
        inside = (facts.freq > 150) & (facts.freq < 300)
        size = np.abs(facts.mobility["G3"][inside])
        assert facts.freq[inside][np.argmax(size)] == pytest.approx(peak, abs=2.0)
    freq = np.array(heavy.modes()["freq"])
    assert np.abs(freq - 201.0).min() < 0.2


def test_parts_that_touch_a_string_at_rest_are_named(found: Comparison) -> None:
    """Cloth on the clavichord's string, whose decay it leaves out; nothing touches the monochord's."""
    (clavichord,) = compare([Candidate(tw.load_instrument("clavichord"))], fs=FS, duration=0.1).instruments
    line = "left out: listing, which touches A3 at rest: pitch and decay of the sound differ from those stated here"
    assert clavichord.warnings == (line,)
    assert not any("left out" in line for facts in found.instruments for line in facts.warnings)


def test_modes_are_those_of_the_table(found: Comparison) -> None:
    """Shapes at the bridge are 1: mass is the table's, T60 = ln 1000 Q / (pi f)."""
    modes = found.instruments[0].body_modes
    assert len(modes) == len(body_table()) == 3
    for mode, row in zip(modes, body_table(), strict=True):
        assert mode.freq == pytest.approx(row["f_Hz"], rel=1e-12)
        assert mode.q == pytest.approx(row["Q"], rel=1e-12)
        assert mode.mass == pytest.approx(row["modal_mass"], rel=1e-9)
        assert mode.residue == pytest.approx(1 / row["modal_mass"], rel=1e-9)
        assert mode.t60 == pytest.approx(math.log(1000) * row["Q"] / (math.pi * row["f_Hz"]), rel=1e-9)


def test_mobility_is_that_of_the_table(found: Comparison) -> None:
    """Y = sum (1/m) i w / (wk^2 - w^2 + i w wk / Q), in dB re 1 (m/s)/N, through the JSON."""
    stated = to_json(found)["instruments"][0]["mobility"]
    w = 2 * np.pi * np.array(stated["freq"])
    total = np.zeros(w.size, dtype=complex)
    for row in body_table():
        wk = 2 * np.pi * row["f_Hz"]
        total += 1j * w / row["modal_mass"] / (wk**2 - w**2 + 1j * w * wk / row["Q"])
    assert np.abs(np.array(stated["level_db"]["A2"]) - 20 * np.log10(np.abs(total))).max() < 0.002
    assert w.size > 500


def test_decay_is_heard_in_the_sound() -> None:
    """T60 of partial 1 from its pole, and from the slope of a band around it in the rendered note.

    The string's planes are one and the same here, so that the partial is one exponential.
    """
    changes = {"strings.A2.polarizations": ["z"]}
    (facts,) = compare(
        [Candidate(tw.load_instrument("monochord").replace(changes))], notes=["A2"], fs=FS, duration=3.0
    ).instruments
    tone, t60 = facts.tones["A2"], facts.strings[0].partials[0].t60
    n = np.arange(len(tone.samples))
    carrier = tone.samples[:, 0] * np.exp(-2j * np.pi * tone.freq * n / FS)
    width = FS // 10
    windows = [carrier[i : i + width] * np.hanning(width) for i in range(FS // 2, 2 * FS, 400)]
    level = [20 * np.log10(np.abs(window.sum())) for window in windows]
    slope = np.polyfit(np.arange(len(level)) * 400 / FS, level, 1)[0]
    assert -60 / slope == pytest.approx(t60, rel=0.02)


def test_cents_follow_the_tension(found: Comparison) -> None:
    """A held tension T' sounds 600 lg2(T'/T) from the note, but for the body's pull; stops follow the open string."""
    a, b = (facts.notes for facts in found.instruments)
    assert all(abs(note.cents) < 1.0 for note in a)
    expected = 600 * math.log2(55.0 / found.instruments[0].strings[0].tension)
    (row,) = [r for r in to_json(found)["notes"] if r["stop"] == 0]
    assert 1200 * math.log2(row["notes"][1]["freq"] / row["notes"][0]["freq"]) == pytest.approx(expected, abs=3.0)
    assert b[0].t60 < 0.7 * a[0].t60  # sigma0 is twice as large


def test_parameters_that_differ_are_those_that_were_changed(found: Comparison) -> None:
    rows = {row.key: row for row in found.parameters}
    assert set(rows) == set(CHANGES)
    assert rows["strings.A2.tension"].values == (58.8, 55.0)
    assert rows["strings.A2.tension"].unit == "N"
    assert rows["strings.A2.loss.sigma0"].unit == "1/s"
    assert rows["tuning.hold"].values == ("pitch", "tension")


def test_a_table_of_the_same_name_that_differs_is_named(tmp_path: Any) -> None:
    folder = tw.list_instruments()["monochord"]
    for name in ("instrument.yaml", "body.csv"):
        (tmp_path / name).write_text((folder / name).read_text(encoding="utf-8").replace("182,25", "190,25"))
    other = tw.load_instrument(tmp_path)
    result = compare([Candidate(tw.load_instrument("monochord")), Candidate(other)], notes=["A2"], fs=FS, duration=0.2)
    (row,) = result.parameters
    assert row.key == "body.table"
    assert len(set(row.values)) == 2
    assert all(value.startswith("body.csv (SHA-256 ") for value in row.values)
    moved = [match for match in result.modes if not alike(match)]
    assert [match.cents(1) for match in moved] == [pytest.approx(1200 * math.log2(190 / 182), abs=1e-6)]


def test_keys_are_those_that_replace_takes() -> None:
    """Setting every number to itself by its key changes nothing, also inside of lists of parts."""
    guitar = tw.load_instrument("classical_guitar")
    keys = {key: value for key, value in flattened(guitar.resolved) if isinstance(value, float)}
    assert len(keys) >= 100
    assert "outputs.microphones.full_scale" in keys
    assert guitar.replace(keys).resolved == guitar.resolved


def mode(freq: float, mass: float, shape: tuple[float, ...]) -> BodyMode:
    vector = np.array(shape, dtype=complex)
    return BodyMode(freq, 30.0, 0.1, 1 / mass, mass, vector / np.sqrt(vector.size))


def test_modes_are_paired_by_shape_before_order() -> None:
    """Two modes that change places are distinguished by their shapes; a third has no partner."""
    heave, rock = (1.0, 1.0), (1.0, -1.0)
    a = [mode(200.0, 0.1, heave), mode(210.0, 0.2, rock), mode(400.0, 0.3, heave)]
    b = [mode(204.0, 0.2, rock), mode(208.0, 0.1, heave), mode(900.0, 0.3, heave)]
    pairs = match_modes([a, b])
    assert [(m.modes[0] and m.modes[0].freq, m.modes[1] and m.modes[1].freq) for m in pairs] == [
        (200.0, 208.0), (210.0, 204.0), (400.0, None), (None, 900.0),
    ]  # fmt: skip


def test_a_mode_of_much_less_mass_is_another_one() -> None:
    rows = match_modes([[mode(216.0, 0.06, (1.0,))], [mode(209.0, 2.7, (1.0,))]])
    assert [None in row.modes for row in rows] == [True, True]


def test_modes_without_shapes_are_paired_by_frequency_and_mass() -> None:
    still = (0.0, 0.0)
    rows = match_modes([[mode(200.0, 0.1, still), mode(300.0, 0.1, still)], [mode(303.0, 0.1, still)]])
    assert [[m and m.freq for m in row.modes] for row in rows] == [[200.0, None], [300.0, 303.0]]


def test_wolves_are_ranked_over_all_instruments() -> None:
    def wolf(string: str, low: float, high: float, severity: float) -> WolfNote:
        return WolfNote(string, low, high, (low + high) / 2, 0.5, 50.0, severity, low, ())

    a, b = (
        [wolf("A2", 205, 226, 57.0), wolf("E2", 98, 106, 43.0)],
        [wolf("A2", 190, 207, 60.0), wolf("A2", 330, 340, 5.0)],
    )
    rows = match_wolves([a, b])
    assert [row.severity_cents for row in rows] == [60.0, 43.0, 5.0]
    assert rows[0].wolves == (a[0], b[0])


def test_players_are_level_matched(found: Comparison) -> None:
    """After the gains both sounds have one loudness by pyloudnorm, and none passes full scale."""
    import pyloudnorm

    tones = [facts.tones["A2"] for facts in found.instruments]
    louder = replace(tones[1], samples=4 * tones[1].samples)
    gains = matched_gains_db([tones[0], louder])
    assert gains[1] - gains[0] == pytest.approx(tones[0].lufs - tones[1].lufs - 20 * math.log10(4), abs=0.05)
    sounds = [sf.read(io.BytesIO(flac(t, g)), always_2d=True) for t, g in zip([tones[0], louder], gains, strict=True)]
    meter = pyloudnorm.Meter(FS)
    heard = [meter.integrated_loudness(x) for x, _ in sounds]
    assert heard[0] == pytest.approx(heard[1], abs=0.1)
    assert all(fs == FS and 0.01 < np.abs(x).max() < 0.95 and len(x) == FS for x, fs in sounds)


def test_gains_leave_a_decibel_under_full_scale(found: Comparison) -> None:
    """Sines are brought to -20 LUFS each; a click that would pass -1 dB re full scale lowers all by the same."""
    tone = found.instruments[0].tones["A2"]
    sine = np.sin(2 * np.pi * 997.0 * np.arange(2 * tone.fs) / tone.fs)[:, None]
    loud, soft = replace(tone, samples=0.5 * sine), replace(tone, samples=0.05 * sine)
    gains = matched_gains_db([loud, soft])
    assert gains[1] - gains[0] == pytest.approx(20.0, abs=0.01)
    assert 20 * math.log10(0.5) + gains[0] == pytest.approx(-20.0 + 3.01, abs=0.05)  # BS.1770: a full sine, -3.01 LUFS
    click = 0.001 * sine
    click[5000] = 0.3
    with_click = matched_gains_db([loud, replace(tone, samples=click)])
    assert gains[0] - with_click[0] > 3.0
    assert 20 * math.log10(0.3) + with_click[1] == pytest.approx(-1.0, abs=0.3)


def test_json_is_plain(found: Comparison) -> None:
    text = json.dumps(to_json(found), allow_nan=False)
    assert json.loads(text)["schema"] == "tonewood-compare/1"
    (alone,) = to_json(replace(found, instruments=found.instruments[:1]))["instruments"]
    assert alone["label"] == "A"


def test_json_has_every_number_of_the_facts(found: Comparison) -> None:
    """Of several instruments what differs, of one nothing of the kind; wolves, notes and mobility as they are."""
    wolf = WolfNote("A2", 205.0, 226.0, 220.0, 0.5, 50.0, 57.0, 216.0, (12, 13))
    both = to_json(replace(found, wolves=match_wolves([[wolf], []])))
    assert {row["key"]: row["values"][1] for row in both["parameters"]}["strings.A2.tension"] == 55.0
    assert both["wolf_notes"] == [[{**asdict(wolf), "stops": [12, 13]}, None]]
    (changed,) = both["changes"]
    assert [row["name"] for row in changed] == [row.name for row in changes(found, 1)]
    assert all(row["times"] == told.times for row, told in zip(changed, changes(found, 1), strict=True))
    one = to_json(replace(found, instruments=found.instruments[:1]))
    assert (one["schema"], "parameters" in one) == ("tonewood-report/1", False)
    facts, told = found.instruments[0], both["instruments"][0]
    string, row = facts.strings[0], told["strings"][0]
    assert (row["tension"], row["length"], row["stops"]) == (string.tension, string.length, string.stops)
    assert [p["freq"] for p in row["partials"]] == [p.freq for p in string.partials]
    for name, mobility in facts.mobility.items():
        np.testing.assert_allclose(told["mobility"]["level_db"][name], 20 * np.log10(np.abs(mobility)), atol=1e-3)
    assert [n["notes"][1]["cents"] for n in both["notes"]] == [m.notes[1] and m.notes[1].cents for m in found.notes]
    assert both["modes"][0]["modes"][0]["q"] == found.modes[0].modes[0].q  # type: ignore[union-attr]


def test_a_player_s_sound_fades_over_its_last_fifty_milliseconds(found: Comparison) -> None:
    tone = replace(found.instruments[0].tones["A2"], samples=np.full((FS, 1), 0.5))
    sound = sf.read(io.BytesIO(flac(tone)), always_2d=True)[0][:, 0]
    np.testing.assert_allclose(sound[: FS - FS // 20], 0.5, atol=1e-4)
    assert sound[FS - FS // 40] == pytest.approx(0.25, abs=1e-3)
    assert abs(sound[-1]) < 1e-3


def test_notes_that_cannot_be_played() -> None:
    monochord = Candidate(tw.load_instrument("monochord"))
    for note, said in (
        ("E9", "no string plays E9"),
        ("H2", "is not a note"),
        ("B7:1", "no string 'B7'"),
        ("A2:99", "0 to 24"),
    ):
        with pytest.raises(TonewoodError, match=said):
            compare([monochord], notes=[note], fs=FS, duration=0.2)
    with pytest.raises(TonewoodError, match="1 to 6"):
        compare([])


def test_units_are_those_of_the_fields_at_any_depth() -> None:
    found = parameters(tw.load_instrument("classical_guitar"))
    units = {
        "strings.E2.tension": "N",  # of a plugin's parameters
        "strings.E2.scatter.split_cents": "cents",  # a section of a string
        "strings.E2.loss.eta_a": "1/s",  # a plugin among the parameters
        "body.points.side.area": "m^2",  # a member of a mapping
        "playing.variation.time": "s",  # a section of a section
        "outputs.listener.volume": "m^3",
        "tuning.hold": "",
    }
    assert {key: found[key].unit for key in units} == units
