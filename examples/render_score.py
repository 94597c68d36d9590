"""Render a MIDI file to a sound file.

python examples/render_score.py
"""

from __future__ import annotations

from pathlib import Path

import tonewood as tw

SCORES = Path(__file__).parent / "scores"


def main(folder: Path = Path()) -> tw.Audio:
    """Write ``prelude.flac``, its first four seconds; returns the sound."""
    score = tw.read_midi(SCORES / "prelude.mid", stop=4.0)
    guitar = tw.load_instrument("classical_guitar")
    audio = tw.render(score, guitar, tail=2.0, tail_level_db=-40.0)
    clipped = audio.save(folder / "prelude.flac", "PCM_24")
    print(f"{audio.duration:.1f} s of {', '.join(audio.channels)}, peak {audio.peak_dbfs:.1f} dBFS, {clipped} clipped")
    return audio


if __name__ == "__main__":
    main()
