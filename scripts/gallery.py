"""A few seconds of every shipped instrument: score, sound, picture, and the command that makes the sound again.

Pages of the documentation show a pair of sounds to switch between where they say ``<!-- sounds: NAME -->``.

python scripts/gallery.py FOLDER
"""

from __future__ import annotations

import atexit
import base64
import io
import re
import shutil
import sys
import tempfile
from contextlib import redirect_stdout
from functools import cache
from importlib.resources import files as package_files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile as sf
from matplotlib.figure import Figure

import tonewood as tw
from tonewood.cli.main import run
from tonewood.sound.level.loudness import matching_gain_db

SCORES = Path(__file__).resolve().parents[1] / "examples" / "scores"
#: s, of every sound
DURATION = 4.0
#: bytes, of a compressed sound
LARGEST = 60_000

#: instrument -> score of `examples/scores`, or notes: (MIDI number, velocity, s from its beginning to the next note's)
PIECES: dict[str, str | list[tuple[int, int, float]]] = {
    "classical_guitar": "greensleeves",
    "flamenco_guitar": "romance",
    "spanish_guitar": "romance",
    "drawn_guitar": "greensleeves",
    "drawn_guitar_x": "chords",
    "steel_guitar": "chords",
    "steel_strings": "scale",
    "african_harp": "pentatonic",
    "monochord": [(45, 80, 0.8), (52, 80, 0.8), (57, 90, 0.8), (61, 100, 1.6)],
    "electric_bass": [  # keys below the instrument's range choose the technique: pluck, palm, slap, pop
        *((12, 1, 0.0), (33, 80, 0.8), (14, 1, 0.0), (33, 100, 0.8)),
        *((17, 1, 0.0), (28, 90, 0.8), (18, 1, 0.0), (43, 100, 1.6)),
    ],
    "tanpura": [(48, 70, 2.0), (48, 100, 2.0)],
    "sitar": [(50, 90, 0.8), (54, 90, 0.8), (57, 90, 0.8), (62, 90, 1.6)],
    "clavichord": [(57, 50, 1.3), (57, 90, 1.3), (57, 120, 1.4)],
    "bowed_monochord": [(50, 80, 1.2), (55, 80, 1.2), (62, 90, 1.6)],
    "buzzing_monochord": [(45, 70, 1.3), (52, 90, 1.3), (57, 110, 1.4)],
    "struck_monochord": [(60, 60, 1.3), (60, 80, 1.3), (67, 100, 1.4)],
    "gong": [(33, 40, 1.3), (33, 90, 1.3), (33, 127, 1.4)],
    "grand_piano": "prelude",
    "twelve_string_guitar": "chords",
}


class Pair(NamedTuple):
    """Two renders of one score.

    Attributes
    ----------
    instrument : plays its piece of the gallery.
    options : label -> options of ``tonewood render``.
    """

    instrument: str
    options: dict[str, tuple[str, ...]]


PAIRS: dict[str, Pair] = {
    "place": Pair(
        "classical_guitar",
        {
            "plucked 3 cm from the bridge": ("--set", "exciters.pluck.from_bridge=0.03"),
            "plucked 18 cm from it": ("--set", "exciters.pluck.from_bridge=0.18"),
        },
    ),
    "bridge": Pair(
        "classical_guitar",
        {
            "as measured": (),
            "30 g on the bridge": ("--set", "body.added=[{at: bridge_middle, mass: 0.030}]"),
        },
    ),
    "room": Pair("classical_guitar", {"dry": (), "in a studio": ("--preset", "studio")}),
    "stretch": Pair("gong", {"a plate that stretches": ("--effects", "all"), "a linear one": ("--effects", "none")}),
}


def command(name: str, options: tuple[str, ...] = ()) -> list[str]:
    """The command that renders an instrument's score beside it."""
    return ["render", f"{name}.mid", "-i", name, "-o", f"{name}.wav", "--max-duration", f"{DURATION:g}", *options]


def score(name: str) -> tw.Score:
    """The score that an instrument plays here."""
    piece = PIECES[name]
    if isinstance(piece, str):
        whole = tw.read_midi(SCORES / f"{piece}.mid", stop=DURATION)
        return tw.Score([note for note in whole.notes if note.time < DURATION - 0.1])
    notes, time = [], 0.0
    for number, velocity, step in piece:
        notes.append(tw.Note(time, max(step, 0.05), note=number, velocity_midi=velocity))
        time += step
    return tw.Score(notes)


def make(folder: Path, name: str) -> tuple[Path, Path, Path]:
    """Write ``NAME.mid``, ``NAME.ogg`` and ``NAME.png``; returns their paths."""
    midi, sound, picture = (folder / f"{name}.{suffix}" for suffix in ("mid", "ogg", "png"))
    mono, fs = _rendered(folder, name, midi, ())
    mono *= 0.7 / np.max(np.abs(mono))  # a level that is alike for all of them
    _compress(sound, mono, fs)
    _draw(mono, fs, picture)
    return midi, sound, picture


def _rendered(folder: Path, name: str, midi: Path, options: tuple[str, ...]) -> tuple[np.ndarray, int]:
    """One channel of the sound that the command makes."""
    tw.write_midi(score(name), midi)
    wav = folder / f"{name}.wav"
    words = [str(folder / word) if word in (midi.name, wav.name) else word for word in command(name, options)]
    try:
        with redirect_stdout(io.StringIO()) as said:
            run(words)
    except SystemExit as ended:
        if ended.code:
            raise RuntimeError(f"tonewood {' '.join(words)} ended with exit code {ended.code}") from None
    if " 0 dropped" not in said.getvalue():
        raise RuntimeError(f"{name} cannot play all of its score: {said.getvalue()}")
    samples, fs = sf.read(str(wav), always_2d=True)
    wav.unlink()
    return samples.mean(axis=1), fs


def _compress(path: Path, mono: np.ndarray, fs: int) -> None:
    with sf.SoundFile(str(path), "w", fs, 1, format="OGG", subtype="VORBIS", compression_level=0.8) as file:
        for start in range(0, len(mono), 4096):
            file.write(mono[start : start + 4096])
    if path.stat().st_size > LARGEST:
        raise RuntimeError(f"{path} has {path.stat().st_size} bytes; {LARGEST} are allowed")


@cache
def player(name: str) -> str:
    """A pair of sounds at one loudness to switch between, as HTML that needs no other file."""
    pair = PAIRS[name]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        sounds = [
            _rendered(folder, pair.instrument, folder / f"{pair.instrument}.mid", o) for o in pair.options.values()
        ]
        sounds = [(mono * 10 ** (matching_gain_db(mono[:, None], fs, -20.0) / 20), fs) for mono, fs in sounds]
        peak = max(float(np.max(np.abs(mono))) for mono, _ in sounds)
        buttons, players = [], []
        for label, (mono, fs) in zip(pair.options, sounds, strict=True):
            _compress(folder / "sound.ogg", mono * min(1.0, 0.9 / peak), fs)
            data = base64.b64encode((folder / "sound.ogg").read_bytes()).decode()
            buttons.append(f'<button type="button" data-sound>{label}</button>')
            players.append(
                f'<audio controls preload="none" aria-label="{label}" src="data:audio/ogg;base64,{data}"></audio>'
            )
    choice = f'<div class="player" hidden><button type="button" data-play>Play</button>{"".join(buttons)}</div>'
    return f'<div class="sounds">{choice}{"".join(players)}</div>'


def with_players(markdown: str) -> str:
    """A page with players in the place of their names."""
    shown, count = re.subn(r"^<!-- sounds: (\w+) -->$", lambda m: player(m[1]), markdown, flags=re.MULTILINE)
    script = (package_files("tonewood.support.page") / "player.js").read_text(encoding="utf-8")
    return f"{shown}\n\n<script>\n{script}</script>\n" if count else markdown


def _draw(sound: np.ndarray, fs: int, path: Path) -> None:
    figure = Figure(figsize=(8, 2.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.4))
    left.plot(np.arange(len(sound)) / fs, sound, lw=0.4, color="#5d4037", rasterized=True)
    left.set(xlabel="s", ylabel="of full scale", ylim=(-1, 1), xlim=(0, len(sound) / fs))
    right.specgram(sound + 1e-12, NFFT=2048, noverlap=1024, Fs=fs, vmin=-130, vmax=-40, cmap="magma")
    right.set(ylim=(0, 6000), xlabel="s", ylabel="Hz")
    figure.savefig(path, dpi=80)


@cache
def files() -> list[Path]:
    """Everything of the gallery, made once for this process in a folder of its own."""
    folder = Path(tempfile.mkdtemp(prefix="tonewood-gallery-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return [path for name in PIECES for path in make(folder, name)]


def page() -> str:
    """The gallery in Markdown."""
    parts = [
        "# Gallery\n",
        f"What do the shipped instruments sound like? Here are the first {DURATION:g} s of a score on each, mixed "
        "to one channel, scaled to one peak level and compressed. The command below a picture makes the sound again "
        "from the score that is linked. `tonewood check INSTRUMENT` lists the sources of an instrument's data.\n",
    ]
    for name in PIECES:
        parts += [
            f"## {name}\n",
            f"{tw.load_instrument(name).spec.title}.\n",
            f'<audio controls preload="none" src="gallery/{name}.ogg"></audio>\n',
            f"![Waveform and spectrogram of {name}](gallery/{name}.png)\n",
            f"```sh\ntonewood {' '.join(command(name))}\n```\n",
            f"Score: [{name}.mid](gallery/{name}.mid)\n",
        ]
    return "\n".join(parts)


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "gallery")
    target.mkdir(parents=True, exist_ok=True)
    for instrument in PIECES:
        make(target, instrument)
