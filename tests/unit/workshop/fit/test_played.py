"""A fitted body is played beside the true one: pitch and decay of the partials that are heard."""

from __future__ import annotations

import numpy as np
import pytest
from fit_scenes import INSTRUMENTS, guitar, random_body

import tonewood as tw
from tonewood.instrument.bundle.loading import Instrument
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.folder import FitFolder
from tonewood.workshop.fit.responses import Responses

FS = 48000


def written(folder, truth):
    """A bundle with the true body: the monochord, its string at the first point."""
    folder.mkdir()
    shapes = truth.residues[0] / np.sqrt(truth.residues[0])
    rows = zip(truth.freq.tolist(), truth.quality.tolist(), shapes.tolist(), strict=True)
    (folder / "body.csv").write_text("f_Hz,Q,a\n" + "".join(f"{f!r},{q!r},{x!r}\n" for f, q, x in rows))
    return folder


def instrument(folder, body, note):
    values = load_yaml(INSTRUMENTS / "monochord" / "instrument.yaml")
    string = {**values["strings"]["A2"], "note": note, "end": "body.a", "polarizations": ["z"]}
    heard = {"name": "out", "plugin": "point_pickup", "quantity": "velocity", "at": "body.a", "full_scale": 1.0}
    given = {
        **values, "body": body, "strings": {"A2": string},
        "outputs": [heard],
    }  # fmt: skip
    return Instrument.from_values(given, folder)


def partials(made, freq, count):
    """Poles of a rendered note's partials, from two windows of the sound half a window apart.

    z(t + T) / z(t) = exp(s T) for each partial, seen through a Hann window that keeps the others out.
    """
    score = tw.Score([tw.Note(0.0, 3.0, string="A2", stop=0, force=1.0)])
    x = tw.render(score, made, fs=FS, outputs=("out",), effects="all", max_duration=1.5).samples[:, 0]
    n, first, later = int(0.5 * FS), int(0.25 * FS), int(0.25 * FS)
    window, t = np.hanning(n), np.arange(n) / FS
    spectrum, bins = np.abs(np.fft.rfft(x[first : first + n] * window, 8 * n)), np.fft.rfftfreq(8 * n, 1 / FS)
    poles = []
    for number in range(1, count + 1):
        inside = (bins > 0.985 * number * freq) & (bins < 1.02 * number * freq)
        level, near = spectrum[inside].max(), bins[inside][np.argmax(spectrum[inside])]
        turn = np.exp(-2j * np.pi * near * t) * window
        before, after = (np.sum(x[k : k + n] * turn) for k in (first, first + later))
        T = later / FS
        poles.append((level, np.log(after * np.exp(-2j * np.pi * near * T) / before) / T + 2j * np.pi * near))
    loudest = max(level for level, _ in poles)
    return [pole if level > 0.01 * loudest else None for level, pole in poles]


def fitted(truth, freq, share):
    mobility, _ = truth.noisy(freq, share, seed=5)
    pairs = tuple((name, "a") for name in "abc"[: len(mobility)])
    return fit_responses(Responses(freq, mobility, pairs))


def compare(tmp_path, truth, fit, note, count):
    FitFolder(fit).write(tmp_path / "fitted")
    parts = load_yaml(tmp_path / "fitted" / "body.yaml")
    table = {"plugin": "modal_table", "table": "body.csv", "shapes": "points", "points": {"a": {"direction": "z"}}}
    pitch = 440.0 * 2 ** ((note - 69) / 12)
    true = partials(instrument(written(tmp_path / "true", truth), table, note), pitch, count)
    made = partials(instrument(tmp_path / "fitted", parts["body"], note), pitch, count)
    heard = [(a, b) for a, b in zip(true, made, strict=True) if a is not None and b is not None]
    cents = [1200 * np.log2(b.imag / a.imag) for a, b in heard]
    decay = [b.real / a.real - 1 for a, b in heard]
    return len(heard), np.abs(cents), np.abs(decay)


@pytest.mark.slow
def test_a_note_on_a_fitted_body(tmp_path):
    truth = random_body(12, seed=3, n_points=2)
    count, cents, decay = compare(tmp_path, truth, fitted(truth, np.arange(70.0, 2000.5), 0.01), 45, 14)
    assert count >= 10
    assert cents.max() < 1.0
    assert decay.max() < 0.05


@pytest.mark.validate
def test_notes_on_a_fitted_guitar(tmp_path):
    """E2 and G3 in the middle of the classical guitar's bridge, three responses to 5 kHz with 1 % noise."""
    truth = guitar(places=(0.0, -0.6, 0.6))
    fit = fitted(truth, np.arange(70.0, 5000.5), 0.01)
    for note in (40, 55):
        folder = tmp_path / str(note)
        folder.mkdir()
        count, cents, decay = compare(folder, truth, fit, note, 16)
        assert count >= 10
        assert cents.max() < 1.0
        assert decay.max() < 0.05
