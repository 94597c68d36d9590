"""Techniques of written music by their sound: files of Guitar Pro played on the electric bass, and measured."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tablatures import enabled, gpif

import tonewood as tw
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled

Floats = NDArray[np.float64]
Row = tuple[int, int, str, str]

FS = 12000
OPTIONS = RenderOptions(fs=FS, outputs=["bridge"], lead_in=0.0)
#: MIDI numbers of the strings, and Hz of the highest one, open
STRINGS, G2 = (28, 33, 38, 43), 440.0 * 2 ** ((43 - 69) / 12)
HIGHEST = 3


@pytest.fixture(scope="module")
def bass() -> tuple[tw.Instrument, object]:
    instrument = tw.load_instrument("electric_bass")
    return instrument, assembled(instrument, OPTIONS)


class Played:
    """A file of one quarter note a beat at 60 a minute, rendered: its score, its performance and its sound."""

    def __init__(self, bass: tuple[tw.Instrument, object], path: Path, rows: Iterable[Row], *changes: tuple[str, str]):
        with zipfile.ZipFile(gpif(path, list(rows))) as archive:
            text = archive.read("Content/score.gpif").decode()
        for old, new in (("40 45 50 55 59 64", " ".join(map(str, STRINGS))), *changes):
            assert old in text
            text = text.replace(old, new)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("Content/score.gpif", text)
        self.score = tw.read_score(path)
        options = OPTIONS.at(max_duration=self.score.duration + 0.1)
        renderer = tw.Renderer(self.score, bass[0], options=options, model=bass[1])
        sound = np.concatenate(list(renderer.blocks()))[:, 0]
        self.sound: Floats = np.append(sound, np.zeros(FS))  # it may end early, decayed
        self.performance = renderer.performance

    def part(self, begin: float, end: float) -> Floats:
        return self.sound[round(begin * FS) : round(end * FS)]

    def level(self, begin: float, end: float) -> float:
        """dB."""
        return 10 * float(np.log10(np.mean(self.part(begin, end) ** 2) + 1e-30))

    def spectrum(self, begin: float, end: float) -> tuple[Floats, Floats]:
        x = self.part(begin, end)
        return np.fft.rfftfreq(16 * len(x), 1 / FS), np.abs(np.fft.rfft(x * np.hanning(len(x)), 16 * len(x)))

    def pitch(self, begin: float, end: float, near: float, *, width: float = 0.04) -> tuple[Floats, Floats]:
        """Times, s, and frequency in cents re `near` (Hz) of the partial there, from the phase after a Hann window."""
        x = self.part(begin - width, end + width)
        time = begin - width + np.arange(len(x)) / FS
        window = np.hanning(round(width * FS))
        slow = np.convolve(x * np.exp(-2j * np.pi * near * time), window / window.sum(), mode="same")
        freq = near + np.gradient(np.unwrap(np.angle(slow))) * FS / (2 * np.pi)
        inner = (time >= begin) & (time < end)
        return time[inner], 1200 * np.log2(freq[inner] / near)


def value(name: str, kind: str, number: object) -> str:
    return f'<Property name="{name}"><{kind}>{number}</{kind}></Property>'


def harmonic(kind: str, node: float) -> str:
    return enabled("Harmonic") + value("HarmonicType", "HType", kind) + value("HarmonicFret", "HFret", node)


def bent(*points: tuple[str, float]) -> str:
    return enabled("Bended") + "".join(value(f"Bend{name}", "Float", x) for name, x in points)


def assert_sounds_at(played: Played, beat: int, freq: float, partial: int) -> None:
    """The strongest partial is that of the node, and none is heard that it is no node of."""
    freqs, level = played.spectrum(beat + 0.25, beat + 0.85)
    assert 1200 * np.log2(freqs[np.argmax(level)] / (partial * freq)) == pytest.approx(0.0, abs=5.0)
    heard = [float(level[np.abs(freqs / freq - k) < 0.2].max()) for k in range(1, 12)]
    others = max(x for k, x in enumerate(heard, 1) if k % partial)
    assert heard[partial - 1] > 10 * others
    assert heard[partial - 1] > 20 * heard[0]


def test_natural_harmonics_sound_at_their_pitch(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    """A string touched over k/n of its length sounds n times its frequency; frets 9 and 4 touch the same partial."""
    nodes = {12: 2, 7: 3, 5: 4, 4: 5, 9: 5, 3.2: 6}
    rows = [(HIGHEST, int(node), harmonic("Natural", node), "") for node in nodes]
    played = Played(bass, tmp_path / "a.gp", rows)
    for beat, partial in enumerate(nodes.values()):
        assert_sounds_at(played, beat, G2, partial)


def test_stopped_harmonics_sound_at_their_pitch(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    kinds = (("Artificial", 12, 2), ("Tap", 7, 3), ("Pinch", 5, 4), ("Semi", 12, 2))
    played = Played(bass, tmp_path / "a.gp", [(HIGHEST, 2, harmonic(kind, node), "") for kind, node, _ in kinds])
    for beat, (_, _, partial) in enumerate(kinds):
        assert_sounds_at(played, beat, G2 * 2 ** (2 / 12), partial)


@pytest.mark.slow
def test_bends_and_the_bar_follow_their_curves(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    """A whole tone up and held; a prebend let go; a dive of the bar, in semitones: 50 of the file are one."""
    up = bent(("OriginOffset", 25.0), ("DestinationOffset", 75.0), ("DestinationValue", 100.0))
    down = bent(("OriginValue", 100.0), ("DestinationValue", 0.0))
    played = Played(
        bass, tmp_path / "a.gp", [(HIGHEST, 12, up, ""), (HIGHEST, 12, down, ""), (HIGHEST, 12, "", "")],
        ('<Beat id="2">', '<Beat id="2"><Whammy originValue="0" destinationOffset="80" destinationValue="-150"/>'),
    )  # fmt: skip
    curves = (
        ((0.0, 0.25, 0.75, 1.0), (0.0, 0.0, 200.0, 200.0)), ((0.0, 1.0), (200.0, 0.0)),
        ((0.0, 0.8, 1.0), (0.0, -300.0, -300.0)),
    )  # fmt: skip
    for beat, (times, cents) in enumerate(curves):
        time, heard = played.pitch(beat + 0.12, beat + 0.9, 2 * G2)
        off = np.abs(heard - np.interp(time - beat, times, cents))
        assert np.quantile(off, 0.9) < 12.0
        assert off.max() < 30.0


def test_vibrato_by_depth_and_rate(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    """Slight and wide: 35 and 80 cents up and back, 5.5 times a second."""
    rows = [(HIGHEST, 12, "", f"<Vibrato>{kind}</Vibrato>") for kind in ("Slight", "Wide")]
    played = Played(bass, tmp_path / "a.gp", rows)
    for beat, depth in enumerate((35.0, 80.0)):
        time, heard = played.pitch(beat + 0.1, beat + 0.9, 2 * G2)
        course = np.cos(2 * np.pi * 5.5 * (time - beat)), np.sin(2 * np.pi * 5.5 * (time - beat)), np.ones_like(time)
        a, b, mean = np.linalg.lstsq(np.stack(course, axis=1), heard, rcond=None)[0]
        assert 2 * np.hypot(a, b) == pytest.approx(depth, rel=0.15)
        assert mean == pytest.approx(depth / 2, abs=6.0)


def test_slides_move_the_pitch_without_a_stroke(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    """A legato slide over three frets, one into a note from below, one out of it upwards."""
    rows = [
        (HIGHEST, 9, value("Slide", "Flags", 2), ""), (HIGHEST, 12, "", ""),
        (HIGHEST, 12, value("Slide", "Flags", 16), ""), (HIGHEST, 12, value("Slide", "Flags", 8), ""),
    ]  # fmt: skip
    played = Played(bass, tmp_path / "a.gp", rows)
    twelfth = 2 * G2

    def cents(at: float) -> float:
        return float(np.median(played.pitch(at, at + 0.05, twelfth, width=0.06)[1]))

    assert cents(0.5) == pytest.approx(-300.0, abs=15.0)
    assert cents(1.3) == pytest.approx(0.0, abs=15.0)
    assert played.level(1.1, 1.3) < played.level(0.7, 0.9)  # struck once
    assert cents(2.03) == pytest.approx(-200.0, abs=30.0)
    assert cents(2.5) == pytest.approx(0.0, abs=15.0)
    assert cents(3.4) == pytest.approx(0.0, abs=15.0)
    _, last = played.pitch(3.9, 4.0, twelfth, width=0.03)
    assert last.max() > 150.0


def onsets(played: Played, begin: float, end: float) -> list[float]:
    """Times, s, at which strokes release their strings."""
    times = sorted(play.time for play in played.performance.timeline.plays)
    return [time for time in times if begin <= time < end]


def test_tremolo_and_trill(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    """Four strokes of a sixteenth, each an attack; a trill alternates between two pitches."""
    rows = [(HIGHEST, 12, "", ""), (HIGHEST, 12, "", "<Trill>57</Trill>")]
    played = Played(bass, tmp_path / "a.gp", rows, ('<Beat id="0">', '<Beat id="0"><Tremolo>1/4</Tremolo>'))
    assert onsets(played, 0.0, 0.99) == pytest.approx([0.0, 0.25, 0.5, 0.75], abs=0.01)
    for stroke in (0.25, 0.5, 0.75):
        assert played.level(stroke + 0.01, stroke + 0.06) > played.level(stroke - 0.06, stroke - 0.02) + 1.0
    for i in range(4):
        _, heard = played.pitch(1.0 + 0.25 * i + 0.12, 1.0 + 0.25 * i + 0.2, 2 * G2, width=0.06)
        assert np.median(heard) == pytest.approx(200.0 * (i % 2), abs=25.0)


def t60(played: Played, begin: float, end: float) -> float:
    """Time of a decay by 60 dB, s, by the slope between two moments."""
    fall = played.level(begin, begin + 0.04) - played.level(end, end + 0.04)
    return 60.0 * (end - begin) / fall


def test_dead_and_muted_notes_decay_fast(bass: tuple[tw.Instrument, object], tmp_path: Path) -> None:
    rows = [(HIGHEST, 5, "", ""), (HIGHEST, 5, enabled("PalmMuted"), ""), (HIGHEST, 5, enabled("Muted"), "")]
    played = Played(bass, tmp_path / "a.gp", rows)
    rings, muted, dead = (t60(played, beat + 0.05, beat + 0.2) for beat in range(3))
    assert rings > 3.0
    assert 0.3 < muted < 1.0
    assert dead < 0.25


@pytest.mark.parametrize(("direction", "order"), [("Down", ("E1", "G2")), ("Up", ("G2", "E1"))])
def test_brushes_spread_their_strings(
    bass: tuple[tw.Instrument, object], tmp_path: Path, direction: str, order: tuple[str, str]
) -> None:
    """A brush downwards begins with the lowest string; 240 of 960 parts of a quarter note, here a second."""
    chord = '<Beat id="0">' + value("Brush", "Direction", direction).join(("<Properties>", "</Properties>"))
    chord += '<XProperties><XProperty id="687935489"><Int>240</Int></XProperty></XProperties>'
    played = Played(
        bass, tmp_path / "a.gp", [(0, 2, "", ""), (HIGHEST, 2, "", "")], ('<Beat id="0">', chord),
        ("<Notes>0</Notes>", "<Notes>0 1</Notes>"), ("<Beats>0 1</Beats>", "<Beats>0</Beats>"),
    )  # fmt: skip
    assert onsets(played, 0.0, 1.0) == pytest.approx([0.0, 0.25], abs=0.005)
    freqs = {"E1": 440.0 * 2 ** ((30 - 69) / 12), "G2": 440.0 * 2 ** ((45 - 69) / 12)}

    def rise(string: str) -> float:
        """Of the fundamental of a string from the time before the second stroke to that after it."""
        before, after = (played.spectrum(at, at + 0.2) for at in (0.01, 0.27))
        early, late = (level[np.argmin(np.abs(freq - freqs[string]))] for freq, level in (before, after))
        return float(late / early)

    assert rise(order[0]) < 1.5
    assert rise(order[1]) > 3.0
