"""Tables, figures and HTML that objects show in a notebook, and strings where strings are meant."""

from __future__ import annotations

import base64
import io
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.errors import BundleError, ScoreError, TonewoodError
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.plotting import COLOURS, SMALL, TEXT, frequency_axis, legend_above
from tonewood.support.plotting import figure as new_figure
from tonewood.support.tables import Table, properties_html

OMEGA, SIGMA, MASS = 2 * np.pi * np.array([100.0, 300.0]), np.array([5.0, 20.0]), np.array([0.5, 0.25])


@pytest.fixture(scope="module")
def basis() -> ModalBasis:
    return ModalBasis.real(OMEGA, SIGMA, {"bridge": [1.0, 2.0]}, modal_mass=MASS)


def test_table_of_modes(basis: ModalBasis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Q = omega / 2 sigma, T60 = ln 1000 / sigma, residue = shape^2 / mass; without pandas and with it."""
    monkeypatch.setitem(sys.modules, "pandas", None)
    light = basis.modes()
    assert isinstance(light, Table)
    assert light["freq"] == pytest.approx([100.0, 300.0])
    assert light["q"] == pytest.approx(OMEGA / (2 * SIGMA))
    assert light["t60"] == pytest.approx(np.log(1000) / SIGMA)
    assert light["residue_bridge"] == pytest.approx([1 / 0.5, 4 / 0.25])
    assert len(light) == 2
    assert repr(light).splitlines()[0].split() == list(light.columns)
    assert light._repr_html_().count("<tr>") == 3
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda columns: ("frame", columns)))
    assert basis.modes() == ("frame", {name: light[name] for name in light.columns})


def test_tables_escape_and_refuse_columns_of_unequal_length() -> None:
    assert "<b>" not in Table({"<b>": ["<b>"]})._repr_html_()
    assert "<b>" not in properties_html("<b>", {"<b>": "<b>"})
    assert "and 40 rows more" in repr(Table({"x": list(range(100))}))
    with pytest.raises(ValueError, match="equally long"):
        Table({"a": [1], "b": [1, 2]})


def test_mobility_that_is_drawn(basis: ModalBasis) -> None:
    """The curve at the modes: 20 lg |Y| of the closed form, frequency logarithmic."""
    (ax,) = basis.plot_mobility().axes
    freq, level = ax.lines[0].get_data()
    s = 2j * np.pi * np.asarray(freq)
    shape = np.array([1.0, 2.0])
    exact = sum(s * p**2 / m / (s**2 + 2 * d * s + w**2) for p, m, d, w in zip(shape, MASS, SIGMA, OMEGA, strict=True))
    assert np.abs(np.asarray(level) - 20 * np.log10(np.abs(exact))).max() < 1e-9
    assert {100.0, 300.0} <= set(np.round(np.asarray(freq), 9))
    assert ax.get_xscale() == "log"
    assert ax.get_ylabel().endswith("dB re 1 (m/s)/N")


def test_figures_of_modes(basis: ModalBasis) -> None:
    q, residue = basis.plot_modes().axes
    assert q.lines[0].get_ydata() == pytest.approx(OMEGA / (2 * SIGMA))
    assert residue.lines[0].get_ydata() == pytest.approx([2.0, 16.0])
    (decay,) = basis.plot_decay().axes
    assert decay.lines[0].get_ydata() == pytest.approx(np.log(1000) / SIGMA)


def test_text_has_nine_points_at_half_size() -> None:
    """Labels have 18, marks 16; also after a later draw, outside of any context."""
    figure, axes = new_figure()
    frequency_axis(axes[0, 0], 20.0, 20000.0)
    figure.canvas.draw()
    assert axes[0, 0].xaxis.label.get_size() / 2 == TEXT / 2 == 9.0
    assert [t.get_text() for t in axes[0, 0].get_xticklabels()][::3] == ["20", "200", "2k", "20k"]
    assert all(t.get_size() == SMALL for t in axes[0, 0].get_xticklabels() + axes[0, 0].get_yticklabels())


def test_colours_differ_without_red_and_green() -> None:
    """Any two of the first five, by lightness or by blue against yellow (CIE L* and b*), as dichromats see them."""

    def lightness_and_blue(colour: str) -> np.ndarray:
        rgb = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        y, z = linear @ [0.2126, 0.7152, 0.0722], linear @ [0.0193, 0.1192, 0.9505] / 1.0888
        return np.array([116 * np.cbrt(y) - 16, 200 * (np.cbrt(y) - np.cbrt(z))])

    places = [lightness_and_blue(colour) for colour in COLOURS[:5]]
    apart = [np.hypot(*(a - b)) for i, a in enumerate(places) for b in places[:i]]
    assert min(apart) > 10


def test_instrument_and_body_show_the_same_modes() -> None:
    guitar = tw.load_instrument("classical_guitar")
    rows = guitar.modes()
    own = guitar.body.modes()
    assert list(rows["freq"]) == list(own["freq"])
    assert "residue_bridge_E2" in list(rows)
    labels = [line.get_label() for line in guitar.plot_mobility().axes[0].lines]
    assert labels == list(guitar.string_names)
    html = guitar._repr_html_()
    assert "E2 (E2)" in html
    assert "D&#x27;Addario" in html
    assert len(repr(guitar.body)) < 60
    assert "heave_rock" in guitar.body._repr_html_()


@pytest.fixture(scope="module")
def score(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("score") / "two.mid"
    tw.write_midi(tw.Score([tw.Note(0.0, 0.2, note="A2"), tw.Note(0.2, 0.2, note="E3")]), path)
    return path


@pytest.fixture(scope="module")
def audio(score: Path) -> tw.Audio:
    return tw.render(score, "monochord", max_duration=0.5)


def test_names_in_place_of_scores_and_instruments(audio: tw.Audio, score: Path) -> None:
    same = tw.render(tw.read_midi(score), tw.load_instrument("monochord"), max_duration=0.5)
    assert np.array_equal(audio.samples, same.samples)
    assert tw.Note(0.0, note="E2") == tw.Note(0.0, note=40.0)
    assert len(tw.plan(str(score), "monochord", max_duration=0.2).notes_dropped) == 0


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (lambda: tw.render(5, "monochord"), ScoreError, "score: is an int; a Score or the path"),
        (lambda: tw.render(tw.Score([]), 5), BundleError, "instrument: is an int; an Instrument, its name"),
        (lambda: tw.render(tw.Score([]), "monochrod"), BundleError, "neither installed nor a folder"),
        (lambda: tw.Renderer(None, "monochord"), ScoreError, "score: is None"),
        (lambda: tw.load_instrument(3.0), BundleError, "instrument: is a float; a name or a folder"),
        (lambda: tw.load_instrument("monochord").replace("a=b"), BundleError, "overrides: is a str; a mapping"),
        (lambda: tw.Note(0.0, note="H2"), ScoreError, "'H2' is not a note"),
        (lambda: tw.Note(0.0, note=[40]), ScoreError, "note of a note is [40]"),
        (lambda: tw.Note(0.0, string=2), ScoreError, "string of a note is an int"),
        (lambda: tw.Score("scale.mid"), ScoreError, "notes of a score are a str"),
        (lambda: tw.Score([40, 45]), ScoreError, "a note of a score is an int"),
    ],
)
def test_wrong_types_get_one_clear_line(call: Any, error: type[TonewoodError], said: str) -> None:
    with pytest.raises(error, match=re.escape(said)) as reported:
        call()
    assert "\n" not in str(reported.value)


def test_player_holds_the_sound(audio: tw.Audio) -> None:
    """A FLAC file of the samples; beyond full scale at its peak, and the text says by how much it is lowered."""
    loud = tw.Audio(audio.samples / np.abs(audio.samples).max() * 2.0, audio.fs, audio.channels)
    for sound, gain in ((audio, 1.0), (loud, 0.5)):
        html = sound._repr_html_()
        encoded = re.findall(r"base64,([^\"]+)", html)[0]
        samples, fs = sf.read(io.BytesIO(base64.b64decode(encoded)), always_2d=True)
        assert fs == audio.fs
        assert np.abs(samples - gain * sound.samples).max() <= 2.0**-15
        assert ("played -6.0 dB" in html) == (gain < 1)


def test_spectrogram_and_level_of_a_sine() -> None:
    """A decaying sine: the loudest row at its frequency, its level falling 60 dB in T60."""
    fs, t60 = 48000, 0.5
    t = np.arange(fs) / fs
    sound = tw.Audio((np.sin(2 * np.pi * 3000 * t) * 10 ** (-3 * t / t60))[:, None], fs)
    image = sound.spectrogram().axes[0].images[0]
    levels, (left, right, low, high) = np.asarray(image.get_array()), image.get_extent()
    row = np.argmax(levels[:, 100])
    assert low + (high - low) * row / (len(levels) - 1) == pytest.approx(3.0, abs=0.02)
    assert 0 == left < right < 1
    time, level = sound.plot_decay().axes[0].lines[0].get_data()
    assert np.polyfit(time, level, 1)[0] == pytest.approx(-60 / t60, rel=1e-3)
    first = 10 * np.log10(np.mean(sound.samples[: round(0.02 * fs)] ** 2))
    assert level[0] == pytest.approx(first, abs=1e-9)


def test_a_legend_has_as_many_columns_as_fit() -> None:
    """80 characters abreast, with 6 for each line's sample."""
    for labels, columns in ((["a" * 30, "b", "c"], 2), (["a", "b", "c"], 3), (["a" * 90, "b"], 1)):
        made, axes = new_figure()
        for label in labels:
            axes[0, 0].plot([0, 1], label=label)
        legend_above(made, axes[0, 0])
        assert made.legends[0]._ncols == columns
