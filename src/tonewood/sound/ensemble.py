"""Several instruments that play the parts of one score: rendered in parallel, mixed to two channels.

A part that has one channel is placed between both by its pan, and one that has two is balanced, at constant power.
"""

from __future__ import annotations

import os
import re
import tempfile
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import BundleError, DroppedNotesWarning, NothingPlayedError, TonewoodError
from tonewood.instrument.model.output_assembly import pan_gains
from tonewood.performance.score.reading import read_score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer, Summary, warn_of_dropped_notes
from tonewood.support.params import Parameters, described, quantity, validated
from tonewood.support.yaml_io import load_yaml

Floats = NDArray[np.float64]
_PART = re.compile(r"(?P<number>\d+)=(?P<instrument>[^@=]+)(?P<rest>(@[^@]+)*)")
_GAIN, _PAN = re.compile(r"([+-]?\d+(\.\d+)?)\s*dB"), re.compile(r"pan\s*([+-]?\d+(\.\d+)?)")


class EnsemblePart(Parameters):
    """One part of an ensemble, as its YAML file has it under ``parts``."""

    part: int = described("number of the part or MIDI channel, from 1", ge=1)
    instrument: str = described("name of a bundle, or path to its folder")
    gain_db: float = quantity("dB", low=-120.0, high=60.0, default=0.0, doc="in the mix")
    pan: float = quantity("1", low=-1.0, high=1.0, default=0.0, doc="-1 left, 1 right")
    set: dict[str, Any] = described("overrides of the instrument, path: value", default={})


class Ensemble(Parameters):
    """An ensemble: the parts of a score and who plays them."""

    parts: list[EnsemblePart] = described("who plays", min_length=1, max_length=64)


def parse_part(text: str) -> EnsemblePart:
    """Read ``NUMBER=INSTRUMENT[@GAINdB][@panPAN]``, e.g. ``2=electric_bass@-3dB@pan-0.3``.

    Raises
    ------
    TonewoodError : one line.
    """
    found = _PART.fullmatch(text.strip())
    values: dict[str, Any] = {}
    words = found["rest"].split("@")[1:] if found else []
    for word in words:
        gain, pan = _GAIN.fullmatch(word.strip()), _PAN.fullmatch(word.strip())
        if gain is None and pan is None:
            found = None
        elif gain is not None:
            values["gain_db"] = float(gain[1])
        elif pan is not None:
            values["pan"] = float(pan[1])
    if found is None:
        raise TonewoodError(f"{text!r} is not NUMBER=INSTRUMENT[@GAINdB][@panPAN], e.g. 2=electric_bass@-3dB@pan-0.3")
    values |= {"part": int(found["number"]), "instrument": found["instrument"].strip()}
    return validated(EnsemblePart, values, key="--part")


def read_ensemble(path: str | os.PathLike[str]) -> list[EnsemblePart]:
    """Read an ensemble's YAML file.

    Raises
    ------
    BundleError : it cannot be read, or a value is not allowed; one line.
    """
    path = Path(path)
    return validated(Ensemble, load_yaml(path, error=BundleError), key="", file=path).parts


@dataclass(frozen=True)
class Stem:
    """One part rendered: its description, its sound in the mix (n, 2) before the mix's gain, and its summary."""

    part: EnsemblePart
    samples: Floats
    summary: Summary


def render_ensemble(
    score: str | os.PathLike[str],
    parts: Sequence[EnsemblePart],
    fs: float | None = None,
    *,
    options: RenderOptions | None = None,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
    reading: dict[str, Any] | None = None,
    **settings: Any,
) -> list[Stem]:
    """Render the parts of a score, each in a process of its own.

    Parameters
    ----------
    score : path of a score's file.
    parts : of it, with their instruments.
    fs, options : as for `Renderer`, of all parts; the lead-in is a number.
    workers : processes at a time; as many as there are processors, where left out; 1 renders in this one.
    progress : called with the name of an instrument when its part is done.
    reading : settings of `read_score`, without tracks.

    Returns
    -------
    One stem per part, all of one length; their sum is the mix.

    Raises
    ------
    TonewoodError : a part or an instrument is not there, or has more than two channels; one line.
    """
    options = RenderOptions.of(options, fs, settings)
    if options.lead_in == "auto":
        raise TonewoodError("is auto; parts that begin together need a number of seconds", key="lead_in")
    jobs = [(os.fspath(score), part, options, reading or {}) for part in parts]
    n = min(workers or os.cpu_count() or 1, len(jobs))
    found: list[tuple[Floats, Summary]] = []
    if n == 1:
        for job in jobs:
            found.append(_rendered(*job))
            if progress is not None:
                progress(job[1].instrument)
    else:
        with (
            tempfile.TemporaryDirectory() as folder,
            ProcessPoolExecutor(n, mp_context=get_context("spawn")) as pool,
        ):
            files = [os.path.join(folder, f"{i}.npy") for i in range(len(jobs))]
            waiting = [pool.submit(_to_file, file, *job) for file, job in zip(files, jobs, strict=True)]
            for file, job, done in zip(files, jobs, waiting, strict=True):
                try:
                    summary = done.result()
                except BrokenProcessPool:
                    raise TonewoodError(
                        f"the process that rendered {job[1].instrument} ended: out of memory?"
                    ) from None
                warn_of_dropped_notes(summary.notes_dropped)
                found.append((np.load(file), summary))
                if progress is not None:
                    progress(job[1].instrument)
    longest = max(len(samples) for samples, _ in found)
    stems = []
    for part, (samples, summary) in zip(parts, found, strict=True):
        out = np.zeros((longest, 2))
        out[: len(samples)] = placed(samples, part)
        stems.append(Stem(part, out, summary))
    return stems


def placed(samples: Floats, part: EnsemblePart) -> Floats:
    """Return a part's sound (n, 2) with its gain and pan."""
    return samples * (10 ** (part.gain_db / 20) * np.array(pan_gains(part.pan, samples.shape[1])))


def _rendered(
    score: str, part: EnsemblePart, options: RenderOptions, reading: dict[str, Any]
) -> tuple[Floats, Summary]:
    from tonewood.instrument.bundle.loading import Instrument

    instrument = Instrument.load(part.instrument).replace(part.set)
    try:
        renderer = Renderer(read_score(score, tracks=[part.part], **reading), instrument, options=options)
    except NothingPlayedError as error:
        raise NothingPlayedError(f"part {part.part} on {part.instrument}: {error.reason}", file=score) from None
    n = len(renderer.channels)
    if n > 2:
        raise TonewoodError(f"{part.instrument} has {n} channels; choose one or two by outputs", key="outputs")
    blocks = list(renderer.blocks(4096))
    return np.concatenate(blocks) if blocks else np.zeros((0, n)), renderer.summary()


def _to_file(file: str, score: str, part: EnsemblePart, options: RenderOptions, reading: dict[str, Any]) -> Summary:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)  # the process that asked for the part issues it
        samples, summary = _rendered(score, part, options, reading)
    np.save(file, samples)
    return replace(summary, effects=())
