"""Change an instrument and hear one note of it: scordatura, heavier strings, another place to pluck.

python examples/another_guitar.py
"""

from __future__ import annotations

from pathlib import Path

import tonewood as tw
import tonewood.authoring as ta
from tonewood.instrument.model.assembly import assemble


def main(folder: Path = Path()) -> dict[str, float]:
    """Write ``usual.wav`` and ``changed.wav``; returns the pitch of the sixth string in both, Hz."""
    usual = tw.load_instrument("classical_guitar")
    changed = usual.replace(
        {
            "strings.E2.note": "D2",
            "strings.*.bending_stiffness": {"scale": 2.0},
            "exciters.pluck.from_bridge": {"fraction": 0.4},
        }
    )
    score = tw.Score([tw.Note(0.0, 1.0, string="E2", stop=0, force=2.0)])
    pitch = {}
    for name, guitar in {"usual": usual, "changed": changed}.items():
        tw.render(score, guitar, max_duration=1.0).save(folder / f"{name}.wav")
        pitch[name] = ta.pitch(assemble(guitar, 48000), "E2").freq
        print(f"{name}: {pitch[name]:.2f} Hz")
    return pitch


if __name__ == "__main__":
    main()
