"""Draws the picture of the README: a measured body, and strings on it.

python scripts/make_images.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot
from PIL import Image

import tonewood as tw
from tonewood.instrument.assembly import assemble
from tonewood.instrument.inspection import bridge_mobility

ROOT = Path(__file__).parents[1]


def main(path: Path = ROOT / "docs" / "images" / "guitar.png") -> None:
    """Bridge mobility of the classical guitar, and the spectrogram of a few bars played on it."""
    guitar = tw.load_instrument("classical_guitar")
    model = assemble(guitar, 48000)
    freq = np.geomspace(60.0, 5000.0, 3000)
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.4), layout="constrained", width_ratios=(1, 1.3))
    for name, mobility in list(bridge_mobility(model, freq).items())[::5]:
        left.semilogx(freq, 20 * np.log10(np.abs(mobility)), lw=1, label=f"under {name}")
    for name, string in model.strings.items():
        left.axvline(string.freq(), color="0.8", lw=0.8, zorder=0)
        left.text(string.freq(), -16.5, name, ha="center", fontsize=7, color="0.4")
    left.set(xlabel="Hz", ylabel="mobility, dB re 1 (m/s)/N", title="the bridge, measured", ylim=(-62, -13))
    left.legend(fontsize=8, loc="lower left")
    score = tw.read_midi(ROOT / "examples" / "scores" / "greensleeves.mid", stop=9.0)
    audio = tw.render(score, guitar, max_duration=9.0)
    mono = audio.samples.mean(axis=1)
    right.specgram(mono + 1e-12, NFFT=4096, noverlap=2048, Fs=audio.fs, vmin=-145, vmax=-55, cmap="magma")
    right.set(ylim=(0, 5000), xlabel="s", ylabel="Hz", title="Greensleeves on it")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=72)
    pyplot.close(figure)
    with Image.open(path) as picture:
        few_colours = picture.convert("RGB").quantize(96)
    few_colours.save(path, optimize=True)


if __name__ == "__main__":
    main()
