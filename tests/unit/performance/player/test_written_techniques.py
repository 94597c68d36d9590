"""Harmonics and slides of written music: which notes are played, and at which pitch they sound."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import tonewood as tw
from tonewood.performance.player.techniques import with_marks
from tonewood.performance.score.assignment import PlayableString
from tonewood.performance.score.harmonics import interval
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled

FS = 22050
STRING = [PlayableString("A2", tuple(45.0 + i for i in range(20)), False)]


def tablature(**values: Any) -> tw.Note:
    values = {"time": 0.1, "duration": 1.2, "stop": 0.0, "velocity_midi": 80.0, "marks": ("tablature",)} | values
    return tw.Note(**values)


@pytest.mark.parametrize(("partial", "stop"), [(2, 0), (3, 0), (4, 0), (5, 0), (3, 2)])
def test_a_harmonic_sounds_its_partial_and_the_multiples(partial: int, stop: int) -> None:
    """A finger on a node of the n-th partial leaves partials n, 2n, ... of the string, and damps all others."""
    note = tablature(note=45.0 + stop + interval(partial), stop=float(stop), partial=partial)
    renderer = tw.Renderer(tw.Score([note]), "steel_strings", fs=FS)
    assert [(a.string, a.stop, a.note.technique) for a in renderer.performance.notes] == [("A2", stop, "harmonic")]
    sound = np.concatenate(list(renderer.blocks())).reshape(-1, len(renderer.channels))[:, 0]
    sound = sound[FS // 2 : 5 * FS // 4]
    level = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), 8 * len(sound)))
    freq = np.fft.rfftfreq(8 * len(sound), 1 / FS)
    f0 = 440.0 * 2 ** ((45 + stop - 69) / 12)
    heard = [float(level[np.abs(freq / f0 - k) < 0.05 * min(k, 4)].max()) for k in range(1, 11)]
    kept, damped = (max(x for k, x in enumerate(heard, 1) if (k % partial == 0) is there) for there in (True, False))
    assert kept > 10 ** (10 / 20) * damped


def partial_cents(string: dict[str, float], u: float, table: Path) -> tuple[list[float], list[float]]:
    """Partials 1 to 6 of a stiff string on a body, re multiples of the first, cents: to first order in Z Y; and |Z Y|.

    w_n = n w (1 + B n^2 / 2) - w Z Im Y(n w) / pi, with B = pi^2 EI / (T L^2) and Z = sqrt(T mu): its end moves.
    """
    modes = np.loadtxt((x for x in table.read_text().splitlines() if x[:1].isdigit()), delimiter=",")
    f, q, heave, cross, rock = modes.T
    w, tension = 2 * np.pi * f, string["T"]
    stiff = np.pi**2 * string["EI"] / (tension * string["L"] ** 2)
    cents, coupled = [], []
    for n in range(1, 7):
        s = 2j * np.pi * n * string["f"]
        mobility = np.sum((heave + 2 * u * cross + u * u * rock) * s / (s * s + s * w / q + w * w))
        end = np.sqrt(tension * string["mu"]) * mobility
        coupled.append(float(abs(end)))
        cents.append(1200 / np.log(2) * (stiff * n * n / 2 - end.imag / (np.pi * n)))
    return [float(x - cents[0]) for x in cents], coupled


@pytest.mark.parametrize(
    ("string", "note", "u", "T", "mu", "EI"),
    [("E2", 40, -1.0, 110.8, 0.009805, 0.0011), ("G3", 55, 0.2, 133.9, 0.002095, 4.65e-5)],
)
def test_a_harmonic_sounds_where_the_string_has_its_partial(
    string: str, note: int, u: float, T: float, mu: float, EI: float
) -> None:
    """Up to 16 cents over a multiple of the fundamental, which alone is tuned, and which the body's modes lower."""
    f = 440.0 * 2 ** ((note - 69) / 12)
    table = Path(__file__).parents[4] / "instruments/steel_strings/body.csv"
    wanted, _ = partial_cents({"T": T, "mu": mu, "EI": EI, "L": 0.645, "f": f}, u, table)
    assert max(wanted) > 13.0
    for partial in range(2, 7):
        played = tablature(note=note + float(interval(partial)), stop=0.0, partial=partial, string=string)
        renderer = tw.Renderer(tw.Score([played]), "steel_strings", fs=FS, max_duration=1.1)
        sound = np.concatenate(list(renderer.blocks())).reshape(-1, len(renderer.channels))[FS // 3 :, 0]
        level = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), 16 * len(sound)))
        freq = np.fft.rfftfreq(16 * len(sound), 1 / FS)
        near = np.abs(freq / (partial * f) - 1) < 0.03
        cents = 1200 * np.log2(freq[near][np.argmax(level[near])] / (partial * f))
        assert cents == pytest.approx(wanted[partial - 1], abs=3.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "near_a_mode"),
    [("classical_guitar", {("A2", 2)}), ("steel_strings", {("A2", 2), ("E2", 3)}), ("electric_bass", set())],
)
def test_harmonics_of_every_string_sound_where_it_has_them(name: str, near_a_mode: set[tuple[str, int]]) -> None:
    """Partials 2 to 5 within 3 cents of the closed form, and 6 dB above those that have no node there.

    Where Z |Y| is above 0.04, a mode of the body lies on the partial, and first order does not hold. The bass's body
    hardly moves, so that its form is that of the stiff string alone.
    """
    folder = Path(__file__).parents[4] / "instruments" / name
    written = yaml.safe_load((folder / "instrument.yaml").read_text(encoding="utf-8"))
    strings, points = written["strings"], written["body"]["points"]
    options = RenderOptions(fs=12000, lead_in=0.0, max_duration=1.2)
    instrument = tw.load_instrument(name)
    model = assembled(instrument, options)
    for string, data in strings.items():
        if string == "defaults":
            continue
        note = model.strings[string].open_note
        freq = 440.0 * 2 ** ((note - 69) / 12)
        keys = {"T": "tension", "mu": "linear_density", "EI": "bending_stiffness"}
        values = {key: float(data[long]) for key, long in keys.items()}
        values |= {"f": freq, "L": float(strings["defaults"]["length"])}
        if name == "electric_bass":
            stiff = np.pi**2 * values["EI"] / (values["T"] * values["L"] ** 2)
            wanted, coupled = [600 / np.log(2) * stiff * (n * n - 1) for n in range(1, 7)], [0.0] * 6
        else:
            wanted, coupled = partial_cents(values, points[f"bridge_{string}"]["u"], folder / "body.csv")
        for partial in range(2, 6):
            played = tablature(time=0.0, note=note + float(interval(partial)), partial=partial, string=string)
            renderer = tw.Renderer(tw.Score([played]), instrument, options=options, model=model)
            sound = np.concatenate(list(renderer.blocks()))[:, 0]
            early, late = sound[1200:4800], sound[4000:]
            levels = np.abs(np.fft.rfft(early * np.hanning(len(early)), 8 * len(early)))
            grid = np.fft.rfftfreq(8 * len(early), 1 / 12000) / freq
            heard = [float(levels[np.abs(grid - k) < 0.2].max()) for k in range(1, 12)]
            assert heard[partial - 1] > 2 * max(x for k, x in enumerate(heard, 1) if k % partial)
            levels = np.abs(np.fft.rfft(late * np.hanning(len(late)), 16 * len(late)))
            grid = np.fft.rfftfreq(16 * len(late), 1 / 12000) / (partial * freq)
            near = np.abs(grid - 1) < 0.03
            cents = 1200 * np.log2(grid[near][np.argmax(levels[near])])
            assert (coupled[partial - 1] > 0.04) is ((string, partial) in near_a_mode)
            if (string, partial) not in near_a_mode:
                assert cents == pytest.approx(wanted[partial - 1], abs=3.0)


def test_a_harmonic_without_its_technique_is_plucked_at_its_pitch() -> None:
    notes = [tablature(note=57.0, partial=2), tablature(time=2.0, note=64.0, partial=3)]
    played = with_marks(tw.Score(notes), ["pluck"], STRING)
    assert [(n.note, n.stop, n.partial, n.technique) for n in played.notes] == [
        (57.0, None, None, None),
        (64.0, None, None, None),
    ]
    assert played.ignored == {"harmonic, plucked as a note of its pitch": 2}


def test_slides_move_one_finger() -> None:
    """Into a note from two frets below, on to another fret, and out of it: one stroke, and slides that reach places."""
    note = tablature(note=50.0, stop=5.0, glides=((0.0, -2.0), (0.2, 0.0), (0.6, 4.0), (1.2, 2.0)))
    played = with_marks(tw.Score([note]), ["pluck", "slide"], STRING)
    assert [(round(n.time, 3), n.note, n.stop, n.technique) for n in played.notes] == [
        (0.1, 48.0, 3.0, None), (0.3, 50.0, 5.0, "slide"), (0.7, 54.0, 9.0, "slide"), (1.27, 52.0, 7.0, "slide"),
    ]  # fmt: skip
    assert played.ignored == {}
    ends = [n.time + n.duration for n in played.notes]
    assert ends == pytest.approx([*(n.time for n in played.notes[1:]), 1.3])  # each lasts until the next
    # without a technique of sliding the fret that is reached within the note is plucked
    plucked = with_marks(tw.Score([note]), ["pluck"], STRING)
    assert [(round(n.time, 3), n.note, n.stop) for n in plucked.notes] == [(0.1, 50.0, 5.0), (0.7, 54.0, 9.0)]
    assert plucked.ignored == {
        "slide into or out of a note, plucked as any note": 1, "slide, plucked as any note": 1,
    }  # fmt: skip
    for glides in ((0.0, -2.0), (0.2, 0.0)), ((1.2, -2.0),):  # into it alone, out of it alone
        one = with_marks(tw.Score([tablature(note=50.0, stop=5.0, glides=glides)]), ["pluck"], STRING)
        assert one.ignored == {"slide into or out of a note, plucked as any note": 1}
