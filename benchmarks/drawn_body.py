"""Figures of a body from its drawing: time, convergence, a bar that moves, and measured guitars beside it.

    python benchmarks/drawn_body.py            # some four minutes

Prints the figures of docs/a_body_from_a_drawing.md. Nothing is taken from the cache; times are those of
one core.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace

os.environ["TONEWOOD_CACHE"] = "off"

import numpy as np

import tonewood as tw
from tonewood.instrument.inspection.frequencies import mobility_bands
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.plate import body_modes
from tonewood.physics.plate.plate import cell_size
from tonewood.physics.plate.tracking import followed
from tonewood.support.blas import one_blas_thread

#: m, cells finer than the default ones, and Hz
FINER, FMAX = (0.0075, 0.0055), 5000.0


@one_blas_thread
def convergence(drawing, name: str) -> None:
    """Frequencies on finer grids."""
    sizes = (cell_size(drawing.top.wood, drawing.top.thickness, 6000.0), *FINER)
    found = []
    for size in sizes:
        began = time.process_time()
        modes = body_modes(replace(drawing, fmax=FMAX, top=replace(drawing.top, size=size)))
        found.append(modes.freq)
        print(f"  {name}, cells of {1e3 * size:.1f} mm: {len(modes.freq)} modes to {FMAX:.0f} Hz in "
              f"{time.process_time() - began:.1f} s")  # fmt: skip
    count = min(100, *map(len, found))
    for size, freq in zip(sizes, found, strict=True):
        apart = np.abs(freq[:count] / found[-1][:count] - 1)
        errors = f"worst {100 * apart.max():.2f} %, {np.count_nonzero(apart > 0.01)} above 1 %"
        errors += f", median {100 * np.median(apart):.2f} %"
        print(f"  {1e3 * size:.1f} mm against {1e3 * FINER[-1]:.1f} mm, first {count} modes: {errors}")


@one_blas_thread
def moved(guitar) -> None:
    """The lower bar in steps of 1 mm."""
    places, steps = np.arange(0.207, 0.2201, 0.001), []
    for x in places:
        body = guitar.replace({"body.braces.bar_low.start.0": float(x), "body.braces.bar_low.stop.0": float(x)}).body
        steps.append(body_modes(replace(body.drawing, fmax=1200.0, top=replace(body.drawing.top, size=0.012))))
    freq = followed(steps, 14)
    cents = 1200 * np.log2(freq / freq[0])
    t = (places - places.mean()) / np.ptp(places)
    print(f"  T1 from {freq[0, 1]:.1f} to {freq[-1, 1]:.1f} Hz")
    for degree in (3, 5):
        scatter = [np.abs(c - np.polyval(np.polyfit(t, c, degree), t)).max() for c in cents.T]
        print(f"  scatter about a curve of degree {degree}, cents: " + " ".join(f"{s:.2f}" for s in scatter))


def mobility() -> None:
    """Bands of the bridge's mobility, mean of the places of six strings."""
    octaves, thirds = 150.0 * 2.0 ** np.arange(6), 150.0 * 2.0 ** (np.arange(16) / 3)
    found = {}
    for name in ("classical_guitar", "flamenco_guitar", "drawn_guitar", "drawn_guitar_x"):
        basis = assemble(tw.load_instrument(name), 48000).body
        points = [p for p in basis.points if p[:7] in ("bridge_", "saddle_") and not p.endswith(("_y", "middle"))]
        found[name] = mobility_bands(basis, points, octaves), mobility_bands(basis, points, thirds)
        print(f"  {name:17} " + " ".join(f"{level:6.1f}" for level in found[name][0]))
    here, there, other = (found[n] for n in ("drawn_guitar", "classical_guitar", "flamenco_guitar"))
    print(f"  octaves from 150 Hz, drawn - classical, dB: {np.round(here[0] - there[0], 1)}; measured pair: "
          f"{np.round(other[0] - there[0], 1)}")  # fmt: skip
    for label, pair in (("drawn - classical", here[1] - there[1]), ("measured pair", other[1] - there[1])):
        print(f"  thirds, {label}, dB: worst {np.abs(pair).max():.1f}, rms {np.sqrt(np.mean(pair**2)):.1f}")


def main() -> None:
    """Print all."""
    for name in ("drawn_guitar", "drawn_guitar_x"):
        body = tw.load_instrument(name).body
        print(name)
        began = time.process_time()
        body.basis(2e4)
        print(f"  whole body to {body.parameters.fmax:.0f} Hz: {time.process_time() - began:.1f} s")
        for line in body.facts():
            print(f"  {line}")
        convergence(body.drawing, name)
    print("the lower bar of drawn_guitar, moved by 13 mm in steps of 1 mm")
    moved(tw.load_instrument("drawn_guitar"))
    print("bridge mobility, dB re 1 (m/s)/N, octaves from 150 Hz")
    mobility()


if __name__ == "__main__":
    main()
