"""Draws the picture of the README, a measured body and strings on it, and the modes of a drawn one.

python scripts/make_images.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import tonewood as tw
from tonewood.cli.app import application
from tonewood.instrument.inspection.frequencies import bridge_mobility
from tonewood.instrument.model.assembly import assemble
from tonewood.sound.level.spectrum import spectrogram
from tonewood.support.plotting import colour_bar, draw_mobility, draw_spectrogram, figure, legend, title

ROOT = Path(__file__).parents[1]


def main(path: Path = ROOT / "docs" / "images" / "guitar.png") -> None:
    """Bridge mobility of the classical guitar, and the spectrogram of a few bars played on it."""
    guitar = tw.load_instrument("classical_guitar")
    model = assemble(guitar, 48000)
    freq = np.geomspace(60.0, 5000.0, 3000)
    made, axes = figure(2, heights=[4.0, 4.0])
    above, below = axes[:, 0]
    ends = list(bridge_mobility(model, freq).items())
    draw_mobility(above, freq, {f"under {name}": mobility for name, mobility in (ends[0], ends[-1])})
    for string in model.strings.values():
        above.axvline(string.freq(), color="0.75", lw=1.0, zorder=0)
    title(above, "the bridge, measured; grey: the open strings")
    legend(above, loc="upper right")
    audio = tw.render(ROOT / "examples" / "scores" / "greensleeves.mid", guitar, max_duration=9.0)
    time, pitch, level = spectrogram(audio.samples, audio.fs, columns=900, freq_upper=5000.0)
    image = draw_spectrogram(below, time, pitch, level - level.max(), floor_db=-80.0)
    below.set_xlabel("time, s")
    title(below, "Greensleeves on it")
    colour_bar(made, image, below, "level, dB")
    path.parent.mkdir(parents=True, exist_ok=True)
    made.savefig(path, dpi=80)
    with Image.open(path) as picture:
        few_colours = picture.convert("RGB").quantize(96)
    few_colours.save(path, optimize=True)


def drawn(path: Path = ROOT / "docs" / "images" / "drawn_guitar.png") -> None:
    """First modes of `drawn_guitar`, as `tonewood modes --plot` draws them."""
    arguments = ["modes", "drawn_guitar", "--string", "E4", "--count", "1", "--plot", str(path)]
    application("modes")(arguments, standalone_mode=False)
    with Image.open(path) as picture:
        smaller = picture.convert("RGB").resize((picture.width * 3 // 5, picture.height * 3 // 5)).quantize(128)
    smaller.save(path, optimize=True)


def heavier(path: Path = ROOT / "docs" / "images" / "heavier.png") -> None:
    """Mobility of the classical guitar's bridge, as measured and with a mass on it."""
    freq = np.geomspace(60.0, 5000.0, 3000)
    guitar = tw.load_instrument("classical_guitar")
    heavy = guitar.replace({"body.added": [{"at": "bridge_middle", "mass": 0.030}]})
    curves = {}
    for label, instrument in (("as measured", guitar), ("30 g on the bridge", heavy)):
        curves[label] = bridge_mobility(assemble(instrument, 48000), freq)["E4"]
    made, axes = figure(1, heights=[4.0])
    draw_mobility(axes[0, 0], freq, curves)
    axes[0, 0].set_xlabel("frequency, Hz")
    title(axes[0, 0], "mobility of the bridge under E4")
    legend(axes[0, 0], loc="upper right")
    made.savefig(path, dpi=80)
    with Image.open(path) as picture:
        few_colours = picture.convert("RGB").quantize(64)
    few_colours.save(path, optimize=True)


if __name__ == "__main__":
    main()
    drawn()
    heavier()
