"""Measures against closed forms, time at equal error against hand-made lines, tables and files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tonewood.errors import TonewoodError
from tonewood.lab.accuracy import catalogue, least_time, report, tables
from tonewood.lab.accuracy.measures import energy_drift, pole_errors, wave_errors
from tonewood.lab.accuracy.outcome import DECAY, PITCH, WAVEFORM, Outcome, Point, front, headlines, line, seconds_at

FS = 48000.0


# ---- measures ----


def test_errors_of_shifted_poles() -> None:
    n = np.arange(1, 41)
    true = -(1.0 + 0.1 * n) + 2j * np.pi * 100.0 * n
    cents = 0.01 * n
    found = 1.05 * true.real + 1j * true.imag * 2 ** (cents / 1200)
    errors = pole_errors(found, true)
    assert errors.cents_median == pytest.approx(0.205, rel=1e-9)
    assert errors.cents_worst == pytest.approx(0.4, rel=1e-9)
    assert errors.cents_20 == pytest.approx(0.2, rel=1e-9)
    assert errors.decay_median == pytest.approx(0.05)
    assert errors.lost == 0


def test_a_partial_half_way_to_the_next_is_lost() -> None:
    true = -1 + 2j * np.pi * 100.0 * np.arange(1, 4)
    found = true.copy()
    found[2] += 2j * np.pi * 51.0
    found[1] = complex(np.nan, np.nan)
    errors = pole_errors(found, true)
    assert errors.lost == 2
    assert errors.cents_worst == 0.0


def test_waveform_error_is_the_relative_norm() -> None:
    t = np.arange(48000) / FS
    true = np.cos(2 * np.pi * 440.0 * t)
    # cos a - cos (a + b) = 2 sin(b / 2) sin(a + b / 2)
    turned = np.cos(2 * np.pi * 440.0 * t + 0.01)
    assert wave_errors(turned, true, FS, np.array([2j * np.pi * 440.0])).waveform == pytest.approx(
        2 * np.sin(0.005), rel=1e-3
    )


def test_spectral_distance_is_a_gain_in_db() -> None:
    t = np.arange(48000) / FS
    freqs = np.array([110.0, 880.0, 3520.0])
    true = np.sum(np.cos(2 * np.pi * freqs[:, None] * t) / freqs[:, None] ** 2, axis=0)
    errors = wave_errors(10 ** (-3 / 20) * true, true, FS, 2j * np.pi * freqs)
    assert errors.spectral_db == pytest.approx(3.0, abs=1e-6)


def test_bands_of_the_spectral_distance_end_a_sixth_of_an_octave_from_their_middle() -> None:
    """Tones on both sides of the edge between 1 and 1.25 kHz, one 6 dB louder, the other 6 dB softer than the truth."""
    t, freqs = np.arange(48000) / FS, 1000.0 * 2.0 ** np.array([0.14, 0.19])
    tones = np.cos(2 * np.pi * freqs[:, None] * t) / freqs[:, None] ** 2
    gain = 10 ** (np.array([6.0, -6.0]) / 20)
    errors = wave_errors(gain @ tones, tones.sum(axis=0), FS, 2j * np.pi * freqs)
    assert errors.spectral_db == pytest.approx(6.0, abs=0.01)


def test_spurious_component_is_found_where_no_partial_is() -> None:
    t = np.arange(48000) / FS
    true = np.cos(2 * np.pi * 1000.0 * t)
    # accelerations: 40 dB down in displacement at twice the frequency is 28 dB down
    sound = true + 0.01 * np.cos(2 * np.pi * 2000.0 * t)
    partials = np.array([2j * np.pi * 1000.0])
    assert wave_errors(sound, true, FS, partials).spurious_db == pytest.approx(-40 + 20 * np.log10(4), abs=0.01)
    beside = true + 0.01 * np.cos(2 * np.pi * 1000.0 * t + 1.0)
    assert wave_errors(beside, true, FS, partials).spurious_db < -90


def test_energy_drift_is_the_largest_change() -> None:
    assert energy_drift(np.array([2.0, 2.2, 1.7])) == pytest.approx(0.15)


# ---- time at equal error ----


def test_a_line_of_order_four_is_read_exactly() -> None:
    # error = c / seconds^4
    made = [(s, 1e-3 / s**4) for s in (0.5, 1.0, 2.0, 4.0)]
    assert seconds_at(made, 1e-3 / 3.0**4) == pytest.approx(3.0)
    assert seconds_at(made, 1e-3 / 4.0**4) == pytest.approx(4.0)


def test_beyond_the_ends_of_a_line() -> None:
    made = [(1.0, 1e-2), (2.0, 1e-3)]
    assert seconds_at(made, 1e-4) is None
    assert seconds_at(made, 1.0) == 1.0
    assert seconds_at([], 1.0) is None


def test_points_that_a_cheaper_one_betters_are_left_out() -> None:
    made = [(1.0, 1e-2), (2.0, 5e-2), (3.0, 1e-3), (3.5, 1e-3)]
    assert front(made) == [(1.0, 1e-2), (3.0, 1e-3)]
    assert seconds_at(made, 1e-2) == 1.0


def point(method: str, fs: float, seconds: float, cents: float, **more: object) -> Point:
    made = Point(
        "s", method, "fs", f"{fs / 1e3:g} kHz", fs, 10, "stable", cents_worst=cents, waveform=cents, seconds=seconds
    )
    return replace(made, **more)  # type: ignore[arg-type]  # passed on


POINTS = (
    point("tonewood", 24e3, 0.5, 1e-1),
    point("tonewood", 48e3, 1.0, 1e-2),
    point("tonewood", 96e3, 2.0, 1e-3),
    point("tonewood", 48e3, 0.1, 1e-9, dial="modes"),
    point("ab3", 200e3, 5.0, 1e-1),
    point("ab3", 800e3, 20.0, 1e-3),
    point("verlet", 100e3, 3.0, 1e-1),
    point("p2", 48e3, np.nan, 1e-5, stable="grows"),
    point("hht", 48e3, 2.0, 1e-5, lost=3),
)


def test_headlines() -> None:
    found = {h.method: h for h in headlines(POINTS, PITCH)}
    assert list(found) == ["ab3", "verlet", "p2", "hht"]
    assert found["ab3"].error == 1e-2
    # half way in the logarithm between 5 and 20 s
    assert found["ab3"].ratio == pytest.approx(10.0)
    assert (found["ab3"].best, found["ab3"].ratio_at_best) == (1e-3, pytest.approx(10.0))
    assert found["verlet"].ratio is None
    assert found["verlet"].ratio_at_best == pytest.approx(6.0)
    assert [found[m].text for m in found] == ["10", "not reached", "not stable", "partials lost"]
    assert {h.method: h for h in headlines(POINTS, WAVEFORM)}["hht"].ratio == pytest.approx(2.0)
    other_dial = point("newmark", 48e3, 1.0, 1e-3, dial="modes")
    assert [h.method for h in headlines((*POINTS, other_dial), PITCH)] == list(found)


def test_other_dials_are_not_on_the_line() -> None:
    assert line(POINTS, "tonewood", PITCH) == [(0.5, 1e-1), (1.0, 1e-2), (2.0, 1e-3)]


def test_without_a_point_of_ours_there_is_no_headline() -> None:
    assert headlines(POINTS[4:], PITCH) == []
    assert headlines(POINTS, DECAY) == []


# ---- names, tables, files ----


def outcome() -> Outcome:
    return Outcome("s", "A system", "closed form", (PITCH, WAVEFORM), POINTS)


def test_unknown_system_is_reported_in_one_line() -> None:
    with pytest.raises(TonewoodError, match="--system: is 'fabre'; there are fabre_guitar, harp"):
        catalogue.selected("fabre")


def test_systems_of_a_run() -> None:
    assert catalogue.selected("harp_block", quick=True) == ["harp_block"]
    assert len(catalogue.selected(None)) == 10
    assert set(catalogue.selected(None)) - set(catalogue.selected(None, quick=True)) == {
        "harp_block",
        "harp_proportional",
    }


def test_tables_have_a_row_per_point_and_method() -> None:
    text = tables.point_table(outcome())
    assert len(text.splitlines()) == 2 + len(POINTS)
    assert len({len(row) for row in text.splitlines()}) == 1
    assert "spurious" not in text  # nothing is known of it
    assert "Adams-Bashforth 3, Udwadia-Kalaba 10;" in tables.headline(outcome())


def cells_of(text: str) -> list[list[str]]:
    """Cells of a table, without its rule."""
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in text.splitlines()]
    return [rows[0], *rows[2:]]


def test_tables_of_methods_say_what_each_measure_finds() -> None:
    """By pitch, where one method has lost partials, and by the waveform; of a second system only two methods."""
    ratio = "time ratio at 0.01"
    assert cells_of(tables.method_table(outcome())) == [
        ["method", f"pitch: {ratio}", "its best", "time ratio there", f"waveform: {ratio}", "its best",
         "time ratio there"],
        ["Adams-Bashforth 3, Udwadia-Kalaba", "10", "0.001", "10", "10", "0.001", "10"],
        ["velocity Verlet, Udwadia-Kalaba", "not reached", "0.1", "6", "not reached", "0.1", "6"],
        ["P2, acceleration constraint", "not stable", "", "", "not stable", "", ""],
        ["HHT-alpha (-0.3)", "partials lost", "", "", "2", "1.0e-05", "not reached by ours"],
    ]  # fmt: skip
    fewer = Outcome("t", "Another", "closed form", (PITCH,), (*POINTS[:4], POINTS[6], POINTS[4]))
    pitch, wave = tables.headline_tables([outcome(), fewer]).split("\n\n")[1::2]
    assert cells_of(pitch) == [
        ["method", "s", "t"],
        ["Adams-Bashforth 3, Udwadia-Kalaba", "10", "not reached"],
        ["velocity Verlet, Udwadia-Kalaba", "not reached", "not reached"],
        ["P2, acceleration constraint", "not stable", ""],
        ["HHT-alpha (-0.3)", "partials lost", ""],
        ["error there", "0.01", "0.01"],
    ]
    assert [row[1:] for row in cells_of(wave)] == [["s"], ["10"], ["not reached"], ["not stable"], ["2"], ["0.01"]]
    assert tables.method_table(replace(fewer, points=())) == "Nothing to compare with in a quick run."


def test_short_table_tells_what_is_not_reached() -> None:
    # Verlet's only point: an error of 0.1 for 3 s, where ours takes 1 s
    assert cells_of(tables.summary_table([outcome()]))[1] == [
        "`s`",
        "0.01",
        "0.01",
        "1",
        "10 x",
        "0.1 at 3 x",
        "",
        "",
        "",
    ]


def test_page_has_all_tables_and_the_picture() -> None:
    machine = {"processor": "x<y", "system": "z", "instruction_set": "avx2", "fma_peak": 1e9}
    study = report.Study([outcome()], machine, True, {"more": ("## More\n\nWords.", [1])})
    page = study.html(b"PNG")
    assert page.count("<table>") == 7  # answers by pitch and waveform; in short, pitch, waveform, methods, points
    assert "<pre>echo $(tonewood accuracy" in page
    assert "data:image/png;base64,UE5H" in page
    assert "x&lt;y" in page
    assert "<h2>More</h2>" in page
    assert "](pictures/a.png)" in study.markdown("pictures/a.png")


def test_what_an_error_costs() -> None:
    """Our cheapest point that is good enough; of the others the quickest, read between its points."""
    found = least_time.cheapest(outcome(), PITCH, 0.05)
    assert found is not None
    assert (found.seconds, found.cents_worst) == (0.1, 1e-9)  # of another dial
    by_rate = replace(outcome(), points=tuple(p for p in POINTS if p.dial == "fs"))
    assert least_time.cheapest(by_rate, PITCH, 0.05) == POINTS[1]
    assert least_time.cheapest(by_rate, PITCH, 1e-6) is None
    name, seconds = least_time.best_peer(outcome(), PITCH, 1e-2) or ("", 0.0)
    assert (name, seconds) == ("ab3", pytest.approx(10.0))
    assert least_time.best_peer(outcome(), PITCH, 1e-6) is None
    assert "AB3 10 x" in least_time.table([by_rate], PITCH)


def test_where_verlet_is_the_quicker_one() -> None:
    """Ours: errors 1e-1 to 1e-3 in 1 to 10 s; Verlet's, of the same order, in a fifth of the time, from 1e-2 on."""
    ours = [replace(POINTS[0], waveform=e, seconds=s) for e, s in ((1e-1, 1.0), (1e-2, 3.0), (1e-3, 10.0))]
    theirs = [replace(p, method="verlet", seconds=p.seconds / 5 * (1 if i < 2 else 10)) for i, p in enumerate(ours)]
    made = Outcome("tension", "", "", (WAVEFORM,), (*ours, *theirs))
    above = least_time.verlet_is_quicker_above(made)
    assert above is not None
    assert 1e-3 < above < 1e-2


def test_charts_are_drawn() -> None:
    pytest.importorskip("matplotlib")
    from tonewood.lab.accuracy.least_time import chart_png

    assert chart_png([outcome()] * 3, dpi=30).startswith(b"\x89PNG")
