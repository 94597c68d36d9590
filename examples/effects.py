"""Hear reactions: tension, contacts, friction, and both hands, one sound file for each instrument that has them.

python examples/effects.py
"""

from __future__ import annotations

from pathlib import Path

import tonewood as tw

#: instrument -> notes: (time, duration, string, stop, technique, force or velocity of the gesture)
SCENES: dict[str, list[tw.Note]] = {
    # a soft pluck, a hard one that glides down and turns its plane; then both hands of the left-handed kind
    "steel_strings": [
        tw.Note(0.0, 0.9, string="A2", stop=0, force=0.8),
        tw.Note(0.9, 1.2, string="A2", stop=0, force=12.0),
        tw.Note(2.1, 0.3, string="D3", stop=2, force=4.0),
        tw.Note(2.4, 0.3, string="D3", stop=4, technique="hammer_on"),
        tw.Note(2.7, 0.3, string="D3", stop=2, technique="pull_off"),
        tw.Note(3.0, 0.8, string="D3", stop=9, technique="slide"),
    ],
    # plucked, damped by the palm, with a plectrum, slapped, popped, a harmonic
    "electric_bass": [
        tw.Note(0.6 * i, 0.6, string="G2", stop=0 if name == "harmonic" else 5, technique=name, force=force)
        for i, (name, force) in enumerate(
            {"pluck": 5.0, "palm": 5.0, "plectrum": 6.0, "slap": None, "pop": 18.0, "harmonic": 6.0}.items()
        )
    ],
    "tanpura": [tw.Note(1.5 * i, 1.5, string="C3", stop=0, force=force) for i, force in enumerate((0.2, 0.4))],
    "sitar": [tw.Note(0.6 * i, 0.6, string="D3", stop=stop, force=1.5) for i, stop in enumerate((0, 4, 7, 12))],
    "clavichord": [tw.Note(0.7 * i, 0.45, string="A3", stop=0, velocity_midi=v) for i, v in enumerate((50, 90, 120))],
    # bowed; then the finger slides up under the bow
    "bowed_monochord": [
        tw.Note(0.0, 1.0, string="D3", stop=0),
        tw.Note(1.0, 1.0, string="D3", stop=5),
        tw.Note(2.0, 1.2, string="D3", stop=12, technique="glide"),
    ],
}


def main(folder: Path = Path(), names: tuple[str, ...] = tuple(SCENES)) -> dict[str, tw.Audio]:
    """Write ``NAME.wav`` for each instrument named; returns the sounds."""
    sounds = {}
    for name in names:
        notes = SCENES[name]
        end = max(note.time + note.duration for note in notes)
        sounds[name] = tw.render(tw.Score(notes), tw.load_instrument(name), max_duration=end)
        sounds[name].save(folder / f"{name}.wav")
        print(f"{name}.wav: {end:.1f} s")
    return sounds


if __name__ == "__main__":
    main()
