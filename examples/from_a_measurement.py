"""From hammer hits on a bridge to an instrument, to the same one with 10 g more on its bridge, and to their pages.

The hits are made here, of a guitar that is known: six on the middle of its bridge, with the signals that accelerometers
and microphones would have given, and noise. The fitted body can then be compared with the truth.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import soundfile as sf

import tonewood as tw
from tonewood.authoring import assemble
from tonewood.instrument.bundle.new_bundle import new_bundle
from tonewood.instrument.inspection.frequencies import mobility_peaks
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.folder import FitFolder, MeasuredPoint, Origin
from tonewood.workshop.fit.radiation import fit_radiation
from tonewood.workshop.report.comparison import Candidate, compare
from tonewood.workshop.report.page import page

FS = 6400
POINTS = {"middle": "bridge_middle", "bass": "bridge_E2", "treble": "bridge_E4"}
MICROPHONES = ("bass", "treble")
#: N, then m/s^2 and Pa, at full scale of the channels of the files
FULL_SCALE = (50.0, 1000.0, 1000.0, 1000.0, 60.0, 60.0)


def make_hits(folder: Path, n_hits: int = 6, microphones: bool = True) -> list[Path]:
    """Write hits: force, three accelerations and two pressures, 1 s each."""
    guitar = tw.load_instrument("classical_guitar")
    body, bank = guitar.body.basis(0.45 * FS), guitar.pickups["microphones"].basis(0.45 * FS)
    rng, t = np.random.default_rng(1), np.arange(4 * FS) / FS
    freq = np.fft.rfftfreq(t.size, 1 / FS)
    responses = [body.frf(freq, point, "bridge_middle", "accelerance") for point in POINTS.values()]
    # of an outward force; the table of this guitar counts forces into the soundboard
    heard = [-bank.frf(freq, name, "heave", "receptance") for name in MICROPHONES]
    responses += heard if microphones else []
    paths = []
    for number in range(1, n_hits + 1):
        force = rng.uniform(8, 25) * np.exp(-0.5 * ((t - 0.01) / rng.uniform(1.6e-4, 2.4e-4)) ** 2)
        channels = [force, *(np.fft.irfft(h * np.fft.rfft(force), t.size) for h in responses)]
        signals = np.array(channels)[:, :FS]
        noise = 0.003 * np.sqrt(np.mean(signals**2, axis=1, keepdims=True)) * rng.normal(size=signals.shape)
        paths.append(folder / f"hit_{number}.wav")
        scale = np.array(FULL_SCALE[: len(signals)])[:, None]
        sf.write(paths[-1], ((signals + noise) / scale).T, FS, subtype="FLOAT")
    return paths


def main(
    folder: Path = Path(), band: tuple[float, float] = (70.0, 2000.0), microphones: bool = True, pages: bool = True
) -> dict[str, float]:
    """Frequency of the strongest resonance below 300 Hz: of the fitted body, and with 10 g in its middle."""
    hits = make_hits(folder, microphones=microphones)
    names = (*POINTS, *(f"{name}_Pa" for name in MICROPHONES * microphones))
    reading = Reading(
        "accelerance", points=names, references=(("middle", ""),), sensitivity=FULL_SCALE[: 1 + len(names)]
    )
    fit = fit_responses(read_responses(hits, reading), band=band)
    places = {"bass": MeasuredPoint("z", -1.0), "middle": MeasuredPoint("z", 0.0), "treble": MeasuredPoint("z", 1.0)}
    radiation = fit_radiation(fit.responses, fit.body, {name: place.u for name, place in places.items()})
    origin = Origin("A guitar that is known", "examples/from_a_measurement.py", "CC-BY-4.0")
    FitFolder(fit, radiation, places, origin).write(folder / "bridge")

    mine = new_bundle(folder / "my_guitar", str(folder / "bridge"))
    heavier = mine.replace({"body.added": [{"at": "middle", "mass": 0.010}]})
    found = {}
    for name, guitar in (("mine", mine), ("heavier", heavier)):
        tw.render(tw.Score([tw.Note(0.0, 1.5, note=40)]), guitar, max_duration=1.5).save(folder / f"{name}.wav")
        model = assemble(guitar.replace({"strings.A2.end": "body.middle"}), 48000)
        peaks = [(y, f) for f, y in mobility_peaks(model, "A2", count=20) if 150 < f < 300]
        found[name] = max(peaks)[1]

    if pages:
        sides = (Candidate(mine), Candidate(heavier, ("10 g on the bridge",)))
        (folder / "compared.html").write_text(page(compare(sides, notes=["A2:12"], duration=2.0)), encoding="utf-8")
        (folder / "heavier.html").write_text(page(compare(sides[1:], notes=["A2"], duration=2.0)), encoding="utf-8")
    return found


if __name__ == "__main__":
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    for name, freq in main(place).items():
        print(f"{name}: {freq:.1f} Hz")
