"""Author the soundboard of `grand_piano`: modes of a drawn board to 1.1 kHz, random ones with its mobility above.

    python scripts/make_soundboard.py instruments/grand_piano     # one to two minutes
    python scripts/make_soundboard.py                             # mobility at the bridges alone, printed

Up to `LIMIT` the modes are those of a drawing: a clamped spruce plate with 16 ribs below and two bridges on it, solved
as `drawn_body` is. Above, waves run between ribs, and the modes are too many for a drawing. Their density and loss are
published statistics. Their modal mass m follows from the mean mobility of a plate (Skudrzyk), Y = n(f) / (4 m): at the
limit Y is the drawing's, and above it falls as that of a beam, the bridge, f^-1/2 (Cremer, Heckl and Petersson,
Structure-borne sound). Shapes are straight between knots along each bridge.

`keybed` is where the noises of keys act (the plugin `key_noise`): -Gamma_k / `CASE`, with Gamma_k the integral of the
board's mass times the shape of drawn mode k, the mass spread evenly; above the limit 0, as shapes of many waves cancel.

`left` and `right` are the pressures at two places 1 m above the board per acceleration of each mode: of drawn modes the
Rayleigh sum at the mode's own frequency (its magnitude, with the sign of its real part), above the limit random numbers
with the rms that radiation at velocity x rho c asks for, continued from the drawn modes.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

import tonewood as tw
from tonewood.physics import plate

Floats = NDArray[np.float64]

SEED = 20
#: Hz, up to which the board is solved, and the size of a cell, m
LIMIT, CELL = 1100.0, 0.032
#: m; x along the keyboard, y away from it: a 2.2 m grand, and its bent side by four places. Lengths, sections and woods
#: are those of an openly shared finite-element model of a grand's board (fan455_piano_synthesis); widths by judgement
WIDTH, DEPTH = 1.60, 2.20
BENT_SIDE = ((0.70, 2.20), (0.835, 2.015), (1.195, 0.72), (1.60, 0.35))
SPRUCE = {"E_L": 11.6e9, "E_R": 0.9e9, "G_LR": 0.75e9, "nu_LR": 0.37, "density": 390, "G_LT": 0.72e9, "G_RT": 0.039e9}
THICKNESS, GRAIN = 9.0e-3, 140.0
#: ribs at right angles to the grain: number, degrees, first on the side (y), last on the front (x), width, heights
RIBS, RIB_ANGLE, FIRST_RIB, LAST_RIB, RIB_WIDTH, RIB_HEIGHT, RIB_END = 16, 40.0, 1.87, 1.20, 0.025, 0.025, 0.005
RIB_WOOD = {"species": "sitka_spruce", "E_L": 13.0e9, "density": 460}
BASS = ((0.350, 1.980), (0.589, 1.322))
TREBLE = ((0.175, 1.870), (0.517, 0.930), (0.919, 0.357), (1.417, 0.125))
BRIDGE_WIDTH, BRIDGE_HEIGHT = 0.035, 0.040
BRIDGE_WOOD = {"species": "maple", "E_L": 13.7e9, "density": 750}
#: m, from the end of a bridge to its first string; knots on each; keys on the bass bridge
FROM_END, BASS_KNOTS, TREBLE_KNOTS, BASS_KEYS = 0.03, 8, 18, 20
#: m, places of the microphones: 1 m above the strings of C4, by judgement 0.6 m apart
MICROPHONES = {"left": (0.30, 1.0, 1.0), "right": (0.90, 1.0, 1.0)}
#: kg, of the case with all that is in it: a grand of this length, by judgement
CASE = 400.0
#: (Hz, modes per Hz), straight between, above the limit: Ege, Boutillon and Rebillat 2013 to 5 kHz; carried on above
DENSITY = ((1100.0, 0.05), (5000.0, 0.02), (5000.1, 0.014), (12000.0, 0.014))
#: (Hz, loss factor): the same, about 2 % to 3 kHz
LOSS = ((1100.0, 0.020), (3000.0, 0.020), (12000.0, 0.0286))
#: m, from rib to rib; modes above the limit are confined to one to three of these, and carried on beyond by `FLOOR`
RIB, FLOOR = 0.130, 0.3


def along(path: tuple[tuple[float, float], ...], count: int) -> tuple[Floats, Floats]:
    """Places of `count` knots of a bridge, and their distance along it, m."""
    corners = np.array(path)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    at = np.linspace(FROM_END, way[-1] - FROM_END, count)
    return np.column_stack([np.interp(at, way, corners[:, k]) for k in (0, 1)]), at


def outline() -> Floats:
    """Corners of the board; the bent side is a cubic x(y)."""
    x, y = np.array(BENT_SIDE).T
    ys = np.linspace(y[0], y[-1], 40)
    bent = np.column_stack([np.polyval(np.polyfit(y, x, 3), ys), ys])
    return np.vstack([[0.0, 0.0], [0.0, DEPTH], bent, [WIDTH, 0.0]])


def ribs(ring: Floats) -> list[tuple[Floats, Floats]]:
    """Ends of the ribs, 4 mm inside the outline."""
    angle = np.deg2rad(RIB_ANGLE)
    way, across = np.array([np.cos(angle), np.sin(angle)]), np.array([np.sin(angle), -np.cos(angle)])
    first = np.array([0.0, FIRST_RIB])
    spacing = (np.array([LAST_RIB, 0.0]) - first) @ across / (RIBS - 1)
    found = []
    for k in range(RIBS):
        # where the line meets the sides of the outline
        a, side = ring, np.roll(ring, -1, axis=0) - ring
        offset = first + k * spacing * across - a
        cross = way[0] * side[:, 1] - way[1] * side[:, 0]
        share = (offset[:, 1] * way[0] - offset[:, 0] * way[1]) / cross
        hit = (share >= 0) & (share < 1)
        s = np.sort(((a + share[:, None] * side)[hit] - first - k * spacing * across) @ way)
        found.append(tuple(first + k * spacing * across + (t + d) * way for t, d in ((s[0], 0.004), (s[-1], -0.004))))
    return found


def drawing() -> dict[str, Any]:
    """Bundle of the board alone."""
    ring = outline()
    beams: dict[str, Any] = {}
    for k, (start, stop) in enumerate(ribs(ring)):
        # the height falls over some 0.15 m at each end
        middle = max(2, int(np.hypot(*(stop - start)) / 0.15) - 1)
        height = [RIB_END, *[RIB_HEIGHT] * middle, RIB_END]
        beams[f"rib_{k + 1}"] = {"start": start, "stop": stop, "width": RIB_WIDTH, "height": height, "wood": RIB_WOOD}
    for name, path in (("bass", BASS), ("treble", TREBLE)):
        for k, (start, stop) in enumerate(pairwise(path)):
            section = {"width": BRIDGE_WIDTH, "height": BRIDGE_HEIGHT, "above": True, "wood": BRIDGE_WOOD}
            beams[f"{name}_{k + 1}"] = {"start": start, "stop": stop, **section}
    knots = np.vstack([along(BASS, BASS_KNOTS)[0], along(TREBLE, TREBLE_KNOTS)[0]])
    body = {
        "plugin": "drawn_body",
        "fmax": LIMIT,
        "cell": CELL,
        "outline": {"points": ring},
        "wood": SPRUCE,
        "thickness": THICKNESS,
        "grain_deg": GRAIN,
        "edge": {"kind": "clamped"},
        "baffle": "infinite",
        "extra_loss": 0.0,
        "braces": beams,
        "points": {f"knot_{k}": {"at": at} for k, at in enumerate(knots)},
    }
    return {"schema": "tonewood-instrument/2", "name": "board", "body": body}


def solved() -> tuple[plate.BodyModes, plate.Sources]:
    """Modes of the drawing below the limit, shapes at its knots, and what they displace."""

    def plain(x: Any) -> Any:
        if isinstance(x, dict):
            return {k: plain(v) for k, v in x.items()}
        if isinstance(x, (list, tuple, np.ndarray)):
            return [plain(v) for v in x]
        return x if isinstance(x, (str, bool)) else float(x)

    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "instrument.yaml").write_text(yaml.safe_dump(plain(drawing())), encoding="utf-8")
        body = tw.load_instrument(folder).body
        return body.modes_below(LIMIT), body.sources(LIMIT)


def mobility_of(freq: Floats, modes: plate.BodyModes) -> NDArray[np.complex128]:
    """(n_freq, knots) Y of the drawn modes, s/kg."""
    w, wn = 2 * np.pi * freq[:, None], 2 * np.pi * modes.freq
    return np.asarray(1j * w / (wn**2 * (1 + 1j * modes.loss) - w**2) @ (modes.shapes**2).T)


def board_mass() -> tuple[float, float]:
    """Mass of plate, ribs and bridges, kg, and area, m^2."""
    x, y = outline().T
    area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
    rib = sum(float(np.hypot(*(b - a))) for a, b in ribs(outline())) * RIB_WIDTH * RIB_HEIGHT * RIB_WOOD["density"]
    bridge = sum(float(np.hypot(*np.subtract(b, a))) for path in (BASS, TREBLE) for a, b in pairwise(path))
    bridge *= BRIDGE_WIDTH * BRIDGE_HEIGHT * BRIDGE_WOOD["density"]
    return area * THICKNESS * SPRUCE["density"] + rib + bridge, area


def moved_by_the_case(sources: plate.Sources) -> Floats:
    """Gamma of each drawn mode, kg^(1/2): the sum of the squares of all is the board's mass."""
    mass, area = board_mass()
    gamma = mass / area * sources.volumes.sum(axis=0)
    print(f"board of {mass:.1f} kg on {area:.2f} m^2; {gamma @ gamma:.1f} kg of it in the drawn modes")
    return np.asarray(gamma)


def frequencies(draws: np.random.Generator) -> Floats:
    """Frequencies above the limit whose spacing is 1 / n(f), each moved by up to 10 % of it."""
    grid = np.linspace(DENSITY[0][0], DENSITY[-1][0], 200_001)
    density = np.interp(grid, *zip(*DENSITY, strict=True))
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
    n = np.arange(int(count[-1])) + 0.5
    return np.interp(n + draws.uniform(-0.1, 0.1, n.size), count, grid)


def confined(bass: Floats, treble: Floats, draws: np.random.Generator) -> Floats:
    """Shape of one mode above the limit at the knots of both bridges, before scaling."""
    places = np.concatenate([bass, treble + bass[-1] + RIB])
    width, centre = RIB * draws.uniform(1.0, 3.0), draws.uniform(0.0, places.max())
    bump = np.exp(-0.5 * ((places - centre) / (0.5 * width)) ** 2)
    return draws.standard_normal(places.size) * (FLOOR + (1 - FLOOR) * bump)


def report(modes: plate.BodyModes) -> None:
    """Print the mobility at the bridges."""
    print(
        f"{len(modes.freq)} modes to {LIMIT:g} Hz, from {modes.freq[0]:.1f} Hz; loss factor {np.median(modes.loss):.3f}"
    )
    print("| Hz | modes per Hz | bass bridge: Re Y, s/kg | treble bridge | both: log-mean of \\|Z\\|, kg/s |")
    print("|---|---:|---:|---:|---:|")
    for low, high in ((60, 150), (150, 400), (400, 700), (700, 1100)):
        both = mobility_of(np.geomspace(low, high, 400), modes)
        y, z = both.real.mean(axis=0), np.exp(-np.log(np.abs(both)).mean())
        density = np.count_nonzero((modes.freq >= low) & (modes.freq < high)) / (high - low)
        print(f"| {low}-{high} | {density:.3f} | {y[:BASS_KNOTS].mean():.1e} | {y[BASS_KNOTS:].mean():.1e} | {z:.0f} |")


def main(folder: Path | None) -> None:
    """Write ``soundboard.csv``."""
    modes, sources = solved()
    report(modes)
    if folder is None:
        return
    draws = np.random.default_rng(SEED)
    (_, bass), (_, treble) = along(BASS, BASS_KNOTS), along(TREBLE, TREBLE_KNOTS)
    freq = frequencies(draws)
    shapes = np.array([confined(bass, treble, draws) for _ in freq])
    # confinement must not change the mean mobility at any knot
    shapes /= np.sqrt(np.mean(shapes**2, axis=0))
    edge = np.geomspace(0.65 * LIMIT, 0.95 * LIMIT, 400)
    mobility = mobility_of(edge, modes).real.mean() * np.sqrt(LIMIT / freq)
    shapes *= np.sqrt(4 * mobility / np.interp(freq, *zip(*DENSITY, strict=True)))[:, None]
    heard = []
    for at in MICROPHONES.values():
        delay = sources.distances(at).min() / plate.SOUND_SPEED
        own = np.array(
            [sources.of(np.arange(len(modes.freq)) == k).pressure(at, f, delay)[0, 0] for k, f in enumerate(modes.freq)]
        )
        drawn = np.abs(own) * np.where(own.real < 0, -1.0, 1.0)
        rms = np.sqrt(np.mean(drawn[modes.freq > edge[0]] ** 2))
        heard.append(np.concatenate([drawn, rms * LIMIT / freq * draws.standard_normal(freq.size)]))
    keybed = np.concatenate([-moved_by_the_case(sources) / CASE, np.zeros(freq.size)])
    shapes = np.vstack([modes.shapes.T, shapes])
    at = [bass, treble]
    parts = np.split(shapes, [BASS_KNOTS], axis=1)
    names = [line.partition(",")[0] for line in (folder / "keys.csv").read_text().splitlines() if line[:1] in "ABCDEFG"]
    counts = (BASS_KEYS, len(names) - BASS_KEYS)
    keys = np.array(
        [
            np.concatenate(
                [np.interp(np.linspace(x[0], x[-1], n), x, v) for x, v, n in zip(at, row, counts, strict=True)]
            )
            for row in zip(*parts, strict=True)
        ]
    )
    freq = np.concatenate([modes.freq, freq])
    q = np.concatenate([1 / modes.loss, 1 / np.interp(freq[len(modes.freq) :], *zip(*LOSS, strict=True))])
    lines = [
        f"# A grand's soundboard by scripts/make_soundboard.py: a drawing to {LIMIT:g} Hz, published statistics above.",
        "# CC-BY-4.0, the tonewood authors. modal_mass in kg; a column per key on its bridge, two that are heard, and "
        "the keybed.",
    ]
    with (folder / "soundboard.csv").open("w", newline="") as stream:
        stream.write("\n".join(lines) + "\n")
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["f_Hz", "Q", "modal_mass", *(name.replace("#", "s") for name in names), *MICROPHONES, "keybed"])
        for f, quality, row, *sound in zip(freq, q, keys, *heard, keybed, strict=True):
            shapes_and_sound = (*(repr(float(x)) for x in row), *(f"{x:.4g}" for x in sound))
            table.writerow([f"{f:.3f}", f"{quality:.3g}", 1, *shapes_and_sound])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
