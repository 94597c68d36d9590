"""Where was the string plucked? A data set is rendered, and a small estimator learns the place on some of its strings.

A string plucked at a share b of its length has partials whose levels follow |sin(n pi b)|, coloured by string, hand and
body. From the levels of 24 partials, less their trend, the estimator learns that colour and its covariance (NumPy
alone), and finds the b of the greatest likelihood. It is tested on strings that it has not heard.

    python examples/place_of_pluck.py FOLDER [SOUNDS]          # pip install "tonewood[dataset]"
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import soundfile
from numpy.typing import NDArray

from tonewood.workshop.batch.rendering import EngineRenderer
from tonewood.workshop.batch.workers import Workers
from tonewood.workshop.dataset.manifest import check_dataset
from tonewood.workshop.dataset.runner import run_dataset

Floats = NDArray[np.float64]
HELD_BACK = ("B3", "A2")
PARTIALS = 24
NUMBERS = np.arange(1, PARTIALS + 1)
#: of a nylon string, about; floor of a dip; share of the diagonal in the covariance
STIFFNESS, FLOOR, SHRINKAGE = 5e-5, 0.1, 0.3
_TREND = np.stack([np.ones(PARTIALS), np.log(NUMBERS), np.log(NUMBERS) ** 2], axis=1)
#: takes a constant, ln n and (ln n)^2 out of levels
DETRENDED = np.eye(PARTIALS) - _TREND @ np.linalg.pinv(_TREND)
MANIFEST: dict[str, Any] = {
    "schema": "tonewood-batch/1",
    "kind": "dataset",
    "name": "place_of_pluck",
    "seed": 20261124,
    "instruments": {"guitar": "classical_guitar"},
    "scores": {"note": {"phrase": [{"time": 0.03, "duration": 0.5, "string": "E4"}]}},
    "sampling": "sobol",
    "parameters": {
        "string": {"path": "note.string", "values": ["E4", "B3", "G3", "D3", "A2", "E2"]},
        "stop": {"path": "note.stop", "values": [0, 1, 2, 3, 4, 5]},
        "place": {"path": "note.from_bridge", "uniform": [0.03, 0.23]},
        "force": {"path": "note.force", "log_uniform": [0.5, 3.0]},
    },
    "render": {"max_duration": 0.4, "effects": "none"},
    "sounds": {"per_shard": 50, "level": "peak"},
}


def heard(folder: Path) -> tuple[list[dict[str, Any]], list[Floats]]:
    """Labels and samples of all sounds: one note each."""
    labels, sounds = [], []
    for path in sorted((folder / "shards").glob("*[0-9].parquet")):
        notes = {n["sound"]: n for n in pq.read_table(path.with_suffix(".notes.parquet")).to_pylist()}
        for row in pq.read_table(path).to_pylist():
            samples, fs = soundfile.read(path.with_suffix(".flac"), start=row["start"], frames=row["frames"])
            labels.append(notes[row["sound"]] | {"fs": fs})
            sounds.append(samples.mean(axis=1) if samples.ndim > 1 else samples)
    return labels, sounds


def levels(label: dict[str, Any], samples: Floats) -> Floats:
    """Levels of the partials in the tenth of a second after the onset, dB, at least -60 re the largest: (PARTIALS,)."""
    fs, freq = label["fs"], 440.0 * 2.0 ** ((label["pitch"] - 69.0) / 12.0)
    piece = samples[label["onset_frame"] :][: round(0.1 * fs)]
    spectrum = np.abs(np.fft.rfft(piece * np.hanning(len(piece)), 4 * len(piece)))
    per_hz = 4 * len(piece) / fs
    found = np.empty(PARTIALS)
    for k, n in enumerate(NUMBERS):
        centre = n * freq * np.sqrt(1.0 + STIFFNESS * n**2)
        low, high = (round((centre + side * 0.3 * freq) * per_hz) for side in (-1, 1))
        found[k] = 20.0 * np.log10(spectrum[low : high + 1].max() + 1e-9)
    return np.maximum(found, found.max() - 60.0) @ DETRENDED


def comb(places: Floats) -> Floats:
    """Levels that an ideal string has at places b, dB, shape (len(places), PARTIALS); dips have a floor."""
    dips = np.sin(np.pi * NUMBERS * places[:, None]) ** 2
    return np.asarray(10.0 * np.log10(dips + FLOOR**2) @ DETRENDED, dtype=np.float64)


class Estimator:
    """Places from levels: comb(b) + colour + deviation, whose mean and covariance are learned.

    The estimate is the place of the greatest likelihood among those of the training.
    """

    def __init__(self, known: Floats, places: Floats):
        deviations = known - comb(places)
        self.colour = deviations.mean(axis=0)
        own = np.cov(deviations.T)
        shrunk = (1.0 - SHRINKAGE) * own + SHRINKAGE * np.trace(own) / PARTIALS * np.eye(PARTIALS)
        self.whitening = np.linalg.inv(np.linalg.cholesky(shrunk))
        self.grid = np.linspace(places.min(), places.max(), 800)

    def __call__(self, new: Floats) -> Floats:
        """Places of the sounds with these levels."""
        away = (new[:, None, :] - self.colour - comb(self.grid)[None, :, :]) @ self.whitening.T
        return np.asarray(self.grid[(away**2).sum(axis=2).argmin(axis=1)], dtype=np.float64)


def main(folder: Path, sounds: int = 256, workers: int = 2) -> dict[str, float]:
    """Render, train and test; returns errors of the place as shares of the string's length."""
    report = run_dataset(
        check_dataset(MANIFEST | {"size": sounds}), folder, folder / "set", EngineRenderer(), Workers(workers)
    )
    labels, samples = heard(report.folder)
    x = np.array([levels(label, sound) for label, sound in zip(labels, samples, strict=True)])
    y = np.array([label["from_bridge"] / label["length"] for label in labels])
    length = np.array([label["length"] for label in labels])
    tested = np.array([label["string"] in HELD_BACK for label in labels])
    errors = Estimator(x[~tested], y[~tested])(x[tested]) - y[tested]
    return {
        "sounds": float(len(y)),
        "held_back": float(tested.sum()),
        "median_error": float(np.median(np.abs(errors))),
        "median_error_mm": float(1e3 * np.median(np.abs(errors * length[tested]))),
        "rms_error": float(np.sqrt(np.mean(errors**2))),
        "rms_error_of_the_mean": float(np.sqrt(np.mean((y[~tested].mean() - y[tested]) ** 2))),
        "beyond_2_percent": float(np.mean(np.abs(errors) > 0.02)),
    }


if __name__ == "__main__":
    result = main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 256)
    print(
        f"{result['held_back']:.0f} of {result['sounds']:.0f} sounds, on strings {' and '.join(HELD_BACK)}, not "
        f"heard before: median error {100 * result['median_error']:.2f} % of the length "
        f"({result['median_error_mm']:.1f} mm); {100 * result['beyond_2_percent']:.0f} % are off by more than 2 %; "
        f"root mean square {100 * result['rms_error']:.1f} %, that of the others' mean "
        f"{100 * result['rms_error_of_the_mean']:.1f} %"
    )
