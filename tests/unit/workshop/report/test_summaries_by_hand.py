"""Sentences, tones, pictures and pages of a comparison, by values worked out by hand."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile as sf
from matplotlib.figure import Figure
from reports_by_hand import FREQ, compared, facts, mode, note, tone, wolf

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.instrument.model.assembly import assemble
from tonewood.support.plotting import figure as plotting_figure
from tonewood.workshop.report import comparison, figures, noticed, page, summary, tones
from tonewood.workshop.report.comparison import ModeMatch, NoteMatch, WolfMatch
from tonewood.workshop.report.facts import InstrumentFacts
from tonewood.workshop.report.figures import mobility_picture, notes_picture, wolf_picture
from tonewood.workshop.report.noticed import LEVEL, Threshold, resonance
from tonewood.workshop.report.page import _origins, _sweep
from tonewood.workshop.report.parameters import ParameterValue
from tonewood.workshop.report.summary import FigureChange, key_figures

# -- summary -----------------------------------------------------------------------------------------------------------


def test_figures_of_an_instrument_are_those_it_has() -> None:
    wolves = (wolf("A", 90, 95, 9.99), wolf("A", 210, 220, 10.0), wolf("A", 310, 320, 30.0))
    heard = {"a": tone("a", -20.0), "b": tone("b", -23.0), "c": tone("c", -math.inf)}
    notes = (note("A", 0, 1.0), note("A", 1, 4.0), note("A", 2, 2.0), note("A", 3, math.inf))
    one = facts(named={"A0": 0, "T1": 1}, mass=0.25, wolves=wolves, tones=heard, notes=notes)
    assert key_figures(one) == {
        "A0": (100.0, "Hz"), "T1": (200.0, "Hz"), "mass of the body": (250.0, "g"),
        "mean mobility, 80 to 1000 Hz": (pytest.approx(-40.0), "dB"), "loudness, mean of the notes": (-21.5, "LUFS"),
        "decay, median T60 of all stops": (2.0, "s"), "worst wolf note, severity": (30.0, "cents"),
        "wolf notes of 10 cents or more": (2.0, ""),
    }  # fmt: skip
    assert key_figures(facts(strings=(), notes=(), mobility={})) == {}
    few = facts(strings=(), notes=(), freq=np.array([80.0, 1000.0]), mobility={"A": np.array([1.0, 0.1])})
    assert key_figures(few)["mean mobility, 80 to 1000 Hz"][0] == pytest.approx(-10.0)
    assert key_figures(replace(few, freq=np.array([79.9, 1000.0]))) == {}


def rows_of(a: InstrumentFacts, b: InstrumentFacts) -> dict[str, FigureChange]:
    return {row.name: row for row in summary.changes(compared(a, b), 1)}


def test_changes_are_told_in_percent_or_in_their_unit() -> None:
    a = facts(named={"T1": 1}, mass=0.2, tones={"x": tone("x", -20.0)}, wolves=(wolf("A", 1, 2, 40.0),))
    moved = (mode(101.0, q=16.0), mode(204.0, q=30.0))
    b = facts("B", named={"T1": 1}, mass=0.19, tones={"x": tone("x", -18.5)}, body_modes=moved)
    found = rows_of(a, b)
    told = {name: (row.difference, row.scale) for name, row in found.items()}
    damping = 100 * ((20 / 16 + 20 / 30) / 2 - 1)
    assert told == {
        "T1": (pytest.approx(2.0), "%"), "mass of the body": (pytest.approx(-5.0), "%"),
        "mean mobility, 80 to 1000 Hz": (0.0, "dB"), "loudness, mean of the notes": (1.5, "dB"),
        "decay, median T60 of all stops": (0.0, "%"), "worst wolf note, severity": (-40.0, "cents"),
        "wolf notes of 10 cents or more": (-1.0, ""), "all body modes, median": (pytest.approx(1.5), "%"),
        "damping of all body modes, median": (pytest.approx(damping), "%"), "mode at 100 Hz": (pytest.approx(1.0), "%"),
    }  # fmt: skip
    assert found["T1"].times == pytest.approx(2.0 / (7.9 / math.sqrt(25.0)))  # the mean Q of both
    assert found["mode at 100 Hz"].times == pytest.approx(1.0 / (7.9 / math.sqrt(18.0)))
    assert found["loudness, mean of the notes"].threshold is LEVEL
    assert found["mass of the body"].threshold is None
    every = found["all body modes, median"]
    assert (every.before, every.after) == pytest.approx((150.0, 152.25))
    lossy = found["damping of all body modes, median"]
    assert (lossy.before, lossy.after) == pytest.approx((5.0, 5.0 * (1 + damping / 100)))
    assert lossy.times == pytest.approx(abs(damping) / 20)


@pytest.mark.parametrize(
    ("before", "unit", "difference", "scale"),
    [
        (0.0, "g", 5.0, "g"),
        (-1.0, "s", 6.0, "s"),
        (4.0, "g", 25.0, "%"),
        (4.0, "LUFS", 1.0, "dB"),
        (4.0, "cents", 1.0, "cents"),
    ],
)
def test_a_figure_that_was_nothing_changes_by_its_unit(before: float, unit: str, difference: float, scale: str) -> None:
    row = summary._change("m", before, 5.0, unit, None)
    assert (row.difference, row.scale, row.times) == (pytest.approx(difference), scale, None)


def test_loudness_is_compared_over_notes_that_both_play() -> None:
    a = facts(tones={"x": tone("x", -20.0), "y": tone("y", -40.0)})
    b = facts("B", tones={"x": tone("x", -21.0), "z": tone("z", 0.0)})
    row = rows_of(a, b)["loudness, mean of the notes"]
    assert (row.before, row.after) == (-20.0, -21.0)
    c = facts("B", tones={"z": tone("z", 0.0)})
    assert "loudness, mean of the notes" not in rows_of(a, c)
    assert summary.lines(compared(a, c), 1)[0].startswith("no note was played on both, so their sounds are not")
    assert not summary.lines(compared(a, b), 1)[0].startswith("no note was played on both")


def test_levels_are_compared_in_one_unit() -> None:
    """-21 LUFS re 4 Pa are -41 LUFS re 40 Pa; sound pressure and acceleration have no common level."""
    a = facts(tones={"x": tone("x", -20.0, full_scale=40.0)})
    b = facts("B", tones={"x": tone("x", -21.0, full_scale=4.0)})
    row = rows_of(a, b)["loudness, mean of the notes"]
    assert (row.before, row.after, row.difference) == pytest.approx((-20.0, -41.0, -21.0))
    c = facts("B", tones={"x": tone("x", -21.0, unit="m/s^2")})
    assert "loudness, mean of the notes" not in rows_of(a, c)
    said = "their outputs are in Pa and m/s^2, so their levels are not compared; of the other figures, "
    assert summary.lines(compared(a, c), 1)[0].startswith(said)


def test_of_strong_modes_below_2_khz_those_that_changed_most_are_told() -> None:
    """Seven move; one is 20.1 dB weaker than the strongest, one lies at 2 kHz: the others by size."""
    freq = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 1999.0, 2000.0]
    shift = [1.01, 1.03, 1.02, 1.0, 1.005, 1.04, 1.015, 1.05]
    # residue * T60 is the size of a peak: of equal Q, residue / freq
    size = [1.0, 1.0, 0.11, 1.0, 1.0, 0.099, 1.0, 1.0]
    a = [replace(mode(f), residue=s * f, t60=1 / f) for f, s in zip(freq, size, strict=True)]
    b = [replace(m, freq=m.freq * k) for m, k in zip(a, shift, strict=True)]
    found = rows_of(facts(body_modes=tuple(a)), facts("B", body_modes=tuple(b)))
    listed = [name for name in found if name.startswith("mode at")]
    assert listed == ["mode at 200 Hz", "mode at 300 Hz", "mode at 1999 Hz", "mode at 100 Hz", "mode at 500 Hz"]
    assert not [n for n in rows_of(facts(body_modes=()), facts("B", body_modes=())) if "mode" in n]
    # rigid motion of 0 Hz on one side or both is no mode that changed
    still = [mode(1.0), replace(mode(1.0), freq=0.0)]
    for pair in ((still[1], still[0]), (still[0], still[1]), (still[1], still[1])):
        one, other = facts(body_modes=pair[:1]), facts("B", body_modes=pair[1:])
        both = replace(compared(one, other), modes=(ModeMatch(pair), ModeMatch((mode(200.0), mode(202.0)))))
        rows = {row.name: row for row in summary.changes(both, 1)}
        assert rows["all body modes, median"].difference == pytest.approx(1.0)
        assert [name for name in rows if name.startswith("mode at")] == ["mode at 200 Hz"]
    # weak before and strong after, or strong before and weak after: the mode counts
    quiet, loud = mode(700.0, mass=1000.0), mode(707.0, mass=0.1)
    for pair in ((quiet, loud), (replace(loud, freq=700.0), replace(quiet, freq=707.0))):
        match = ModeMatch(pair)
        one, other = facts(body_modes=(pair[0],)), facts("B", body_modes=(pair[1],))
        both = replace(compared(one, other), modes=(match, ModeMatch((mode(300.0), mode(300.0)))))
        assert "mode at 700 Hz" in [row.name for row in summary.changes(both, 1)]


@pytest.mark.parametrize(
    ("difference", "times", "words"),
    [
        (-24.0, 0.96, "hardly heard: 0.96 x the least noticed"),
        (-25.0, 1.0, "may be heard: 1 x the least noticed"),
        (25.0, 0.625, "hardly heard: 0.62 x the least noticed"),
    ],
)
def test_a_verdict_is_by_the_threshold_of_its_direction(difference: float, times: float, words: str) -> None:
    row = FigureChange("decay", 1.0, 1.0, "s", difference, "%", Threshold(25.0, 40.0, "x"))
    assert (row.times, row.verdict) == (times, words)
    assert summary.heard_words(compared(facts(), facts("B")), 1, [row]) == (
        "by published thresholds these may be heard: decay"
        if times >= 1
        else "no change here reaches a published threshold of hearing"
    )
    assert resonance(0.25).more == 7.9  # never more


@pytest.mark.parametrize(
    ("threshold", "less", "more", "source"),
    [
        (noticed.resonance(25.0), 1.58, 1.58, "Gagné and Zurek 1988"),
        (noticed.BODY_FREQ, 1.0, 1.0, "Woodhouse et al. 2012"),
        (noticed.BODY_DAMPING, 20.0, 20.0, "Woodhouse et al. 2012"),
        (noticed.LEVEL, 0.93, 0.93, "Jesteadt et al. 1977"),
        (noticed.DECAY, 25.0, 40.0, "Järveläinen and Tolonen 2001"),
    ],
)
def test_thresholds_are_those_that_were_published(threshold: Threshold, less: float, more: float, source: str) -> None:
    assert (threshold.less, threshold.more) == pytest.approx((less, more), abs=0.005)
    assert threshold.source == source
    assert [threshold.times(x) for x in (-2 * less, 0.0, 3 * more)] == pytest.approx([2.0, 0.0, 3.0], rel=0.01)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (123.456, "Hz", "123.5 Hz"),
        (-20.04, "LUFS", "-20.0 LUFS"),
        (1.236, "s", "1.24 s"),
        (12.6, "cents", "13 cents"),
        (2.0, "", "2"),
        (3.456, "%", "3.46 %"),
        (197.04, "g", "197.0 g"),
    ],
)
def test_figures_in_words(value: float, unit: str, text: str) -> None:
    assert summary.value_words(value, unit) == text


@pytest.mark.parametrize(
    ("difference", "scale", "text"),
    [(1.26, "%", "+1.3 %"), (-0.04, "dB", "0 dB"), (-3.4, "cents", "-3 cents"), (2.0, "", "+2"), (0.0, "", "0")],
)
def test_differences_in_words(difference: float, scale: str, text: str) -> None:
    assert summary.difference_words(FigureChange("", 0, 0, "", difference, scale, None)) == text


def test_lines_of_a_terminal_stand_in_columns() -> None:
    a, b = facts(notes=(note("A", 0, 10.0),)), facts("B", notes=(note("A", 0, 5.0),), body_modes=())
    a = replace(a, body_modes=())
    assert summary.lines(compared(a, b), 1) == [
        "by published thresholds these may be heard: decay, median T60 of all stops",
        "  mean mobility, 80 to 1000 Hz    -40.0 dB to -40.0 dB     0 dB  no threshold is published",
        "  decay, median T60 of all stops   10.00 s to   5.00 s  -50.0 %  may be heard: 2 x the least noticed",
        "  worst wolf note, severity        0 cents to  0 cents  0 cents  no threshold is published",
        "  wolf notes of 10 cents or more         0 to        0        0  no threshold is published",
    ]


# -- tones -------------------------------------------------------------------------------------------------------------


def test_places_of_notes() -> None:
    model = assemble(tw.load_instrument("monochord"), 16000)
    assert tones.place(model, "A2:0") == ("A2", 0.0)
    assert tones.place(model, "A2:24") == ("A2", 24.0)
    assert tones.place(model, "C#3") == ("A2", 4.0)
    for wrong in ("A2:25", "A2:-1", "A2:1.5", "A2:", "A2:²", "B2:0"):
        with pytest.raises(TonewoodError):
            tones.place(model, wrong)
    assert tones.place_name(model, "A2", 4) == "C#3"
    guitar = assemble(tw.load_instrument("classical_guitar"), 16000)
    assert tones.place_name(guitar, "E2", 5) == "E2:5"  # the left hand would take the open string
    assert tones.place_name(guitar, "A2", 0) == "A2"
    near = guitar.strings["A2"].freq(7)
    stops = replace(wolf("A2", near, near, 9.0), stops=(5, 6, 7, 8))
    assert comparison.nearest_stop(guitar, stops) == 7
    rows = [facts(wolves=(wolf("E2", 80, 90, 9.0), stops)), facts("B")]
    assert comparison.default_notes(rows[:1], [guitar]) == ["E2", "A2", "D3", "G3", "B3", "E4", "A2:7"]
    assert comparison.default_notes(rows, [guitar, guitar]) == ["E2", "E4", "A2:7"]


@pytest.mark.parametrize(
    ("count", "played"), [(12, range(12)), (13, [*range(11), 12]), (23, range(0, 23, 2)), (0, []), (1, [0])]
)
def test_twelve_open_strings_are_played(monkeypatch: pytest.MonkeyPatch, count: int, played: Any) -> None:
    monkeypatch.setattr(comparison, "place_name", lambda model, name, stop: f"{name}:{stop}")
    monkeypatch.setattr(comparison, "_fault", lambda model, note: "")
    harp: Any = SimpleNamespace(groups={f"s{i}": None for i in range(count)})
    assert comparison.default_notes([facts()], [harp]) == [f"s{i}:0" for i in played]
    ends = [f"s{i}:0" for i in dict.fromkeys((0, count - 1))] if count else []
    assert comparison.default_notes([facts(), facts()], [harp, harp]) == ends


def test_a_note_that_is_played_lasts_as_long_as_asked() -> None:
    monochord = tw.load_instrument("monochord")
    model = assemble(monochord, 8000)
    played = tones.play_note(monochord, model, "A2:12", fs=8000, duration=0.25, velocity_midi=80.0)
    assert played.samples.shape == (2000, 1)
    assert (played.note, played.string, played.stop, played.fs) == ("A2:12", "A2", 12.0, 8000)
    assert played.freq == model.strings["A2"].freq(12)
    assert played.peak_dbfs == pytest.approx(20 * math.log10(np.abs(played.samples).max()))
    assert np.abs(played.samples[-80:]).max() > 0.01 * np.abs(played.samples).max()  # it is held to the end


def test_silence_keeps_its_gain_and_two_channels_are_heard() -> None:
    silent = tone("s", samples=np.zeros((4800, 1)), peak_dbfs=-math.inf)
    assert tones.matched_gains_db([silent]) == [0.0]
    assert tones.matched_gains_db([]) == []
    samples = np.tile([0.1, 0.2, 0.4], (480, 1))
    sound, fs = sf.read(io.BytesIO(tones.flac(tone("x", samples=samples), 20 * math.log10(2))), always_2d=True)
    assert (sound.shape, fs) == ((480, 2), 4800)
    np.testing.assert_allclose(sound[:240], np.tile([0.2, 0.4], (240, 1)), atol=1e-4)
    assert (samples == [0.1, 0.2, 0.4]).all()
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(240) / 240)
    np.testing.assert_allclose(sound[240:, 0], 0.2 * fade, atol=1e-4)
    short = sf.read(io.BytesIO(tones.flac(tone("x", samples=np.full((4, 1), 0.5)))), always_2d=True)[0]
    np.testing.assert_allclose(short[:, 0], 0.5 * (0.5 + 0.5 * np.cos(np.pi * np.arange(4) / 4)), atol=1e-4)


# -- pictures and pages ------------------------------------------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures as they are made."""
    made: list[Figure] = []
    monkeypatch.setattr(figures, "_svg", lambda figure: made.append(figure) or "")
    return made


def test_mobility_of_one_instrument_is_a_curve_of_each_end(drawn: list[Figure]) -> None:
    ends = {f"s{i}": 10.0 ** (-i) * (1 + 0j * FREQ) for i in range(7)}
    mobility_picture(compared(facts(mobility=dict(list(ends.items())[:6]))))
    assert [line.get_ydata()[0] for line in drawn[0].axes[0].lines] == pytest.approx([-20.0 * i for i in range(6)])
    mobility_picture(compared(facts(mobility=ends)))
    assert [line.get_ydata()[0] for line in drawn[1].axes[0].lines] == pytest.approx(
        [-20.0 * i for i in (0, 1, 2, 3, 4, 6)]
    )
    assert mobility_picture(compared(facts(mobility={}))) is None
    only = facts("B", mobility={"s9": ends["s0"]})
    assert mobility_picture(compared(facts(mobility=ends), only)) is None


def test_the_difference_of_mobilities_is_that_of_their_means(drawn: list[Figure]) -> None:
    """Two ends of 20 and 40 dB less against one of 6 and 10 dB more: 8 dB at all frequencies."""
    one = {"a": 0.1 + 0j * FREQ, "b": 0.01 + 0j * FREQ}
    gains = {"a": 10 ** (6 / 20), "b": 10 ** (10 / 20)}
    other = facts("B", mobility={name: y * gains[name] for name, y in one.items()})
    mobility_picture(compared(facts(mobility=one), other))
    upper, lower, below = drawn[0].axes[:3]
    assert [line.get_ydata()[5] for line in upper.lines] == pytest.approx([-20.0, -14.0])
    assert [line.get_ydata()[5] for line in lower.lines] == pytest.approx([-40.0, -30.0])
    np.testing.assert_allclose(below.lines[0].get_ydata(), 8.0)
    assert [ax.get_ylabel() for ax in drawn[0].axes[:3]] == ["mobility\ndB re 1 (m/s)/N"] * 2 + ["less A, dB"]
    assert [ax.get_xlabel() for ax in drawn[0].axes[:3]] == ["", "", "frequency, Hz"]
    assert below.lines[1].get_ydata()[0] == 0.0
    assert [ax.get_title() for ax in drawn[0].axes[:3]] == [
        "at the end of a", "at the end of b", "difference, mean of all ends, third octaves"
    ]  # fmt: skip
    for ax in drawn[0].axes[:3]:
        assert ax.get_xlim() == pytest.approx((40.0, 10000.0))
    x = below.lines[0].get_xdata()
    assert (x[0], x[-1], len(x)) == (pytest.approx(40 * 2 ** (1 / 6)), pytest.approx(10000 / 2 ** (1 / 6)), 120)


def test_levels_in_bands_are_over_what_all_instruments_have() -> None:
    """20 dB a decade by third octaves: those of the frequency between their ends."""
    spans = ((40.0, 5000.0), (100.0, 10000.0), (20.0, 8000.0))
    each = [np.geomspace(*ends, 400) for ends in spans]
    made = [facts(freq=f, mobility={"A": 1e-4 * f + 0j, "B": 1e-2 * f + 0j}) for f in each]
    freq, levels = figures.band_levels(compared(*made), ["A", "B"])
    assert (freq[0], freq[-1], len(freq)) == (
        pytest.approx(100.0 * 2 ** (1 / 6)), pytest.approx(5000.0 / 2 ** (1 / 6)), 120
    )  # fmt: skip
    for level in levels:
        np.testing.assert_allclose(level, 20 * np.log10(1e-3 * freq), atol=1e-3)


def test_notes_are_a_panel_of_each_string_and_a_curve_of_each_instrument(drawn: list[Figure]) -> None:
    rows = tuple(
        NoteMatch(f"s{k}", stop, (note(f"s{k}", stop, 1.0 + stop), None if k else note("s0", stop, math.inf)))
        for k in range(13)
        for stop in (0, 1)
    )
    notes_picture(compared(facts(), facts("B"), notes=rows), "t60")
    panels = [ax for ax in drawn[0].axes if ax.lines]
    assert [ax.get_title() for ax in panels] == [f"s{k}" for k in range(12)]
    assert [line.get_ydata().tolist() for line in panels[1].lines[:1]] == [[1.0, 2.0]]
    assert np.isnan(panels[0].lines[1].get_ydata()).all()
    assert np.isnan(panels[1].lines[1].get_ydata()).all()
    labelled = [bool(ax.get_xlabel()) for ax in panels]
    assert labelled == [False] * 10 + [True] * 2


def test_bars_of_wolf_notes_stand_beside_each_other(drawn: list[Figure]) -> None:
    rows = tuple(WolfMatch((wolf("A", 220 + 40 * k, 220 + 40 * k, 50.0 - k), None)) for k in range(11))
    both = replace(rows[0], wolves=(None, wolf("A", 440, 440, 7.0)))
    wolf_picture(compared(facts(), facts("B"), wolves=(both, *rows)))
    bars = drawn[0].axes[0].patches
    assert [bar.get_width() for bar in bars] == [0.0, *(50.0 - k for k in range(9)), 7.0, *[0.0] * 9]
    middle = [bar.get_y() + bar.get_height() / 2 for bar in bars]
    assert middle == pytest.approx([k - 0.2 for k in range(10)] + [k + 0.2 for k in range(10)])
    assert drawn[0].axes[0].get_ylim() == (9.5, -0.5)  # the worst on top
    labels = [t.get_text() for t in drawn[0].axes[0].get_yticklabels()]
    assert labels[:3] == ["A near A4", "A near A3", "A near C4"]


def test_levels_of_tones_are_drawn_below_the_loudest_of_the_first(drawn: list[Figure]) -> None:
    one, other = facts(tones={"x": tone("x")}), facts("B", tones={"x": tone("x", level=(-20.0, -2.0, -50.0))})
    figures.decay_picture(compared(facts("Z"), one, other), "x")
    axes = drawn[0].axes[0]
    assert [line.get_ydata().tolist() for line in axes.lines] == [[-5.0, 0.0, -25.0], [-15.0, 3.0, -45.0]]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 2.0), (-80.0, 8.0))
    assert axes.get_ylabel().endswith("maximum of A")
    scaled = facts("B", tones={"x": tone("x", full_scale=10.0)})
    velocity = facts("C", tones={"x": tone("x", unit="m/s", level=(-20.0, -8.0, -9.0))})
    figures.decay_picture(compared(one, scaled, velocity), "x")
    axes = drawn.pop().axes[0]
    assert [line.get_ydata().tolist() for line in axes.lines[1:]] == [[15.0, 20.0, -5.0], [-12.0, 0.0, -1.0]]
    assert axes.get_ylabel().endswith("maximum of each")
    figures.decay_picture(compared(one), "x")
    assert drawn[1].axes[0].get_ylabel().endswith("maximum")


@pytest.mark.parametrize(("freq", "window"), [(69.9, 8192), (70.0, 4096)])
def test_low_notes_have_the_longer_window(monkeypatch: pytest.MonkeyPatch, freq: float, window: int) -> None:
    """4096 or 8192 samples at 48 kHz."""
    asked: list[int] = []

    def analysed(samples: Any, fs: int, **options: Any) -> Any:
        asked.append(options["window"])
        assert (options["freq_upper"], options["columns"]) == (6000.0, 500)
        return np.array([0.0, 1.0]), np.array([0.0, 1000.0]), np.array([[-3.0, -90.0], [-20.0, -40.0]])

    shown: list[Any] = []
    draw = figures.draw_spectrogram
    monkeypatch.setattr(figures, "spectrogram", analysed)
    monkeypatch.setattr(figures, "draw_spectrogram", lambda *g, **o: shown.append((g[3], o)) or draw(*g, **o))
    played = facts(tones={"x": tone("x", freq=freq, fs=48000)})
    figures.spectrogram_picture(compared(played), "x")
    assert asked == [window]
    np.testing.assert_allclose(shown[0][0], [[0.0, -87.0], [-17.0, -37.0]])
    assert shown[0][1] == {"floor_db": -80.0}


def test_cells_of_a_page_are_those_of_the_facts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "sweep_picture", lambda found: "picture")
    a = facts(parameters={"x": ParameterValue(2.5, "")}, mass=0.2, notes=(note("A", 0, 4.0), note("A", 1, 4.0)))
    b = facts("B", parameters={"x": ParameterValue(1.0, "")}, kinds={"cited": 1}, notes=(note("A", 0, 1.0),))
    found = compared(a, b, sweep="x")
    table = _sweep(found)
    decay, mass = table["names"].index("decay, median T60 of all stops"), table["names"].index("mass of the body")
    assert [(v, label, row[decay], row[mass]) for v, label, row in table["rows"]] == [
        ("1", "B", "1.00 s", "\N{EN DASH}"), ("2.5", "A", "4.00 s", "200.0 g")
    ]  # fmt: skip
    assert [(labels, f.label) for labels, f in _origins(compared(a, b, facts("C")))] == [("A, C", "A"), ("B", "B")]
    stops = wolf("A", 1, 2, 9.0, (1, 2))
    named = facts(notes=(note("A", 0, name="A2"), note("A", 1, name="A#2"), note("A", 2, name="B2"), note("B", 1)))
    assert page._wolf_stops(named, stops) == "A#2, B2"
    told = page._summary(found, 1)
    assert (told["index"], told["label"]) == (1, "B")
    row = next(row for row in told["rows"] if row[0].startswith("decay"))
    assert row[1:5] == ("4.00 s", "1.00 s", "-75.0 %", True)
    still = next(row for row in told["rows"] if row[0].startswith("worst"))
    assert (still[4], still[6]) == (False, "")


def test_sounds_of_a_page_are_those_of_instruments_that_play_the_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "matched_gains_db", lambda played: [-1.0, -2.0][: len(played)])
    monkeypatch.setattr(page, "flac", lambda one, gain: f"{one.note} {gain}".encode())
    monkeypatch.setattr(page, "decay_picture", lambda *given: "decay")
    monkeypatch.setattr(page, "spectrogram_picture", lambda *given: "spectrogram")
    one, other = facts(tones={"A:1": tone("A:1", stop=1.0)}), facts("B", missing_tones={"A:1": "no such stop"})
    named = replace(one, label="C", notes=(note("A", 0), note("A", 1, name="A#2")))
    found = page._tone(compared(one, other, named), "A:1")
    assert found["note"] == "A:1 (A2)"
    assert [(s["index"], s["label"], s["gain_db"]) for s in found["sounds"]] == [
        (0, "A: box", -1.0),
        (2, "C: box", -2.0),
    ]
    assert found["missing"] == ["B does not play A:1: no such stop"]
    assert page._tone(compared(facts(tones={"A2": tone("A2")})), "A2")["note"] == "A2"


# -- a comparison as a whole -------------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Comparisons of instruments that are names; strings are in their models, notes beyond `high` cannot be played."""
    asked: list[Any] = []

    def assembled(instrument: Any, fs: int, *, alone: bool) -> Any:
        asked.append(("assemble", instrument, fs, alone))
        strings = {} if instrument == "plate" else {"A": 0}
        return SimpleNamespace(name=instrument, strings=strings, groups=strings)

    def fault(model: Any, name: str) -> str:
        return f"{model.name} has no {name}" if name == "high" or (model.name, name) == ("two", "mid") else ""

    def played(instrument: Any, model: Any, name: str, **how: Any) -> Any:
        asked.append(("play", instrument, model.name, name, how))
        return tone(name)

    place = "tonewood.workshop.report.comparison."
    monkeypatch.setattr(f"{place}assemble", assembled)
    monkeypatch.setattr(f"{place}_fault", fault)
    monkeypatch.setattr(f"{place}play_note", played)
    monkeypatch.setattr(f"{place}default_notes", lambda instruments, models: ["usual"])
    monkeypatch.setattr(
        f"{place}gather", lambda model, label, changes, called: facts(label, changes=changes, called=called)
    )
    return asked


def candidate(name: Any, *changes: str, called: str = "") -> Any:
    return comparison.Candidate(name, changes, called)


def test_a_comparison_plays_what_each_instrument_can(quick: list[Any]) -> None:
    shares: list[float] = []
    found = comparison.compare(
        [candidate("one"), candidate("two", "x=1", called="mine")], notes=["low", "mid", "low"], fs=8000, duration=0.5,
        velocity_midi=70.0, sweep="x", tell=shares.append,
    )  # fmt: skip
    assert shares == pytest.approx([0.25, 0.5, 0.7, 0.9])
    assert quick[:2] == [("assemble", "one", 8000, True), ("assemble", "two", 8000, True)]
    how = {"fs": 8000, "duration": 0.5, "velocity_midi": 70.0}
    assert quick[2:] == [("play", "one", "one", "low", how), ("play", "one", "one", "mid", how),
                         ("play", "two", "two", "low", how)]  # fmt: skip
    one, two = found.instruments
    assert (one.label, two.label, two.changes, two.called) == ("A", "B", ("x=1",), "mine")
    assert (list(one.tones), list(two.tones)) == (["low", "mid"], ["low"])
    assert (one.missing_tones, two.missing_tones) == ({}, {"mid": "two has no mid"})
    assert (found.tones, found.duration, found.velocity_midi, found.sweep) == (("low", "mid"), 0.5, 70.0, "x")
    assert [m.modes[0] and m.modes[0].freq for m in found.modes] == [100.0, 200.0]
    assert len(found.notes) == 2
    alone = comparison.compare([candidate("one")])
    assert alone.tones == ("usual",)
    assert quick[-1][4] == {"fs": 48000, "duration": 4.0, "velocity_midi": 80.0}


def test_comparisons_that_cannot_be(quick: list[Any]) -> None:
    for count in (0, 7):
        with pytest.raises(TonewoodError, match=f"{count} instruments; 1 to 6 are allowed"):
            comparison.compare([candidate("one")] * count)
    assert len(comparison.compare([candidate("one")] * 6).instruments) == 6
    with pytest.raises(TonewoodError, match="one has no high") as fault:
        comparison.compare([candidate("one"), candidate("two")], notes=["high"])
    assert fault.value.key == "--notes high"
    with pytest.raises(TonewoodError, match="a body without strings plays none"):
        comparison.compare([candidate("one"), candidate("plate")], notes=["low"])
    assert comparison.compare([candidate("plate")]).tones == ("usual",)


def test_pictures_have_words_for_those_who_do_not_see_them(drawn: list[Figure]) -> None:
    one, other = facts(tones={"x": tone("x")}, wolves=(wolf("A", 1, 2, 9.0),)), facts("B")
    both, alone = compared(one, other), compared(one)
    said = {
        "Mobility of the body of box at the ends of its strings": mobility_picture(alone),
        "Mobility of the bodies at the ends of A, overlaid, and their difference": mobility_picture(both),
        "T60, s of every note, by string": notes_picture(both, "t60"),
        "cents of every note, by string": notes_picture(both, "cents_mounted"),
        "Severity of the worst wolf notes": wolf_picture(both),
        "Level of x over time": figures.decay_picture(both, "x"),
    }
    assert all(picture is not None and picture.alt == words for words, picture in said.items())
    spectrogram = figures.spectrogram_picture(alone, "x")
    assert (spectrogram.alt, spectrogram.uri[:22]) == ("Spectrogram of x", "data:image/png;base64,")
    values = [{"a.b": ParameterValue(x, "")} for x in (2.0, 1.0)]
    swept = compared(replace(one, parameters=values[0]), replace(other, parameters=values[1]), sweep="a.b")
    assert figures.sweep_picture(swept).alt == "Figures of the instrument over a.b"
    panels = [ax for ax in drawn[-1].axes if ax.lines]
    assert [ax.lines[0].get_xdata().tolist() for ax in panels] == [[1.0, 2.0]] * len(panels)
    by_name = {ax.get_title(): ax.lines[0].get_ydata().tolist() for ax in panels}
    assert by_name["worst wolf note"] == [0.0, 9.0]
    assert [ax.get_xlabel() for ax in panels[-2:]] == ["b", "b"]


def test_a_picture_is_an_address_that_holds_it() -> None:
    made, _ = plotting_figure(heights=[1.0])
    assert figures._svg(made).startswith("data:image/svg+xml")


def test_the_first_modes_of_a_whole_surface_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three rows of one body, a row of each of several; rigid motion is left out."""
    rows: list[Any] = []
    monkeypatch.setattr(
        figures, "draw_shapes", lambda axes, surface, freq, q: rows.append((len(axes), surface, freq, q))
    )
    monkeypatch.setattr(figures, "png", lambda made, dpi: b"png")
    columns = figures.COLUMNS
    freq = np.r_[0.0, np.arange(1.0, 40.0)]
    basis = SimpleNamespace(natural_freq=freq, damping_ratio=np.full(40, 0.01))
    surface: Any = SimpleNamespace(areas=np.ones(2), of=lambda moves: np.flatnonzero(moves))
    drawn_body = facts(surface=surface, surface_modes=basis)
    alone = figures.shapes_picture(compared(drawn_body))
    assert alone is not None
    assert alone.alt == "First modes of the bodies of box"
    (one,) = rows
    assert one[0] == 3 * columns
    np.testing.assert_array_equal(one[1], np.arange(1, 3 * columns + 1))
    np.testing.assert_allclose(one[2], freq[1 : 3 * columns + 1])
    np.testing.assert_allclose(one[3], 50.0)
    rows.clear()
    both = figures.shapes_picture(compared(drawn_body, facts("B"), replace(drawn_body, label="C")))
    assert both is not None
    assert both.alt == "First modes of the bodies of A, C"
    assert [row[0] for row in rows] == [columns, columns]
    np.testing.assert_array_equal(rows[1][1], np.arange(1, columns + 1))
    assert figures.shapes_picture(compared(facts())) is None
    surface.areas = np.zeros(0)
    assert figures.shapes_picture(compared(drawn_body)) is None
