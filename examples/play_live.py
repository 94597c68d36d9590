"""Play on the sound card; without one, say so and compute the same blocks unheard.

python examples/play_live.py
"""

from __future__ import annotations

import tonewood as tw
from tonewood.errors import OutputError


def main() -> int:
    """How many frames went out."""
    notes = [tw.Note(0.15 * i, 1.0, note=n, force=1.5) for i, n in enumerate((45, 52, 57, 60))]
    renderer = tw.Renderer(tw.Score(notes), tw.load_instrument("classical_guitar"), max_duration=1.0)
    try:
        played = tw.play(renderer)
    except OutputError as error:
        print(f"not played: {error}")
        return sum(len(block) for block in renderer.blocks(1024))
    print(f"{played.frames} frames, {played.underruns} underruns")
    return played.frames


if __name__ == "__main__":
    main()
