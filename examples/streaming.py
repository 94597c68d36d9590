"""Take sound block by block, go back to where one was, and go on otherwise.

python examples/streaming.py
"""

from __future__ import annotations

import itertools

import numpy as np

import tonewood as tw


def main() -> float:
    """Largest difference between the first samples and those after going back: none at all."""
    score = tw.Score([tw.Note(0.0, 2.0, note=45, force=1.5), tw.Note(0.3, 2.0, note=52, force=1.5)])
    renderer = tw.Renderer(score, tw.load_instrument("monochord"), max_duration=1.0)
    stream = renderer.blocks(512)
    head = np.concatenate(list(itertools.islice(stream, 40)))
    checkpoint = renderer.snapshot()
    tail = np.concatenate(list(stream))
    renderer.restore(checkpoint)
    again = np.concatenate(list(renderer.blocks(4096)))  # other blocks, the same samples
    summary = renderer.summary()
    print(f"{len(head)} + {len(tail)} frames, {summary.notes} notes, ended: {summary.end}")
    return float(np.abs(again - tail).max())


if __name__ == "__main__":
    main()
