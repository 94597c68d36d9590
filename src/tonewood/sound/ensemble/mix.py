"""Several instruments that play the parts of one score: rendered in parallel, mixed to two channels.

A part that has one channel is placed between both by its pan, and one that has two is balanced, at constant power.
Volume (7), expression (11) and pan (10) of a part's MIDI channel act on its sound in the mix, not on its strings:

    gain = (cc7 · cc11)²,   pan = part's pan + (128 cc10 - 64) / 63, between -1 and 1

with the values as shares of 127, 1 before the first (General MIDI 2, MIDI Manufacturers Association 1999, pages 8 and
9); a change takes `GLIDE` s.
"""

from __future__ import annotations

import math
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import BundleError, DroppedNotesWarning, NothingPlayedError, OutputError, TonewoodError
from tonewood.instrument.model.output_assembly import pan_gains
from tonewood.performance.score.note import Control, Score
from tonewood.performance.score.reading import read_score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer, Summary, silence, warn_of_dropped_notes
from tonewood.support.arrays import Floats
from tonewood.support.params import Parameters, described, quantity, validated
from tonewood.support.yaml_io import load_yaml

#: controllers that act on a part's sound in the mix
MIXED = ("cc7", "cc10", "cc11")
#: s that a change of one of them takes
GLIDE = 0.01
_PART = re.compile(r"(?P<number>\d+)=(?P<instrument>[^@=]+)(?P<rest>(@[^@]+)*)")
_GAIN, _PAN = re.compile(r"([+-]?\d+(\.\d+)?)\s*dB"), re.compile(r"pan\s*([+-]?\d+(\.\d+)?)")


class EnsemblePart(Parameters):
    """One part of an ensemble, as its YAML file has it under ``parts``."""

    part: int = described("number of the part or MIDI channel, from 1", ge=1)
    instrument: str = described("name of a bundle, or path to its folder")
    programs: list[int] | None = described("programs of General MIDI, from 1, whose notes it plays", default=None)
    gain_db: float = quantity("dB", low=-120.0, high=60.0, default=0.0, doc="in the mix")
    pan: float = quantity("1", low=-1.0, high=1.0, default=0.0, doc="-1 left, 1 right")
    set: dict[str, Any] = described("overrides of the instrument, path: value", default={})


class Ensemble(Parameters):
    """An ensemble: the parts of a score and who plays them."""

    parts: list[EnsemblePart] = described("who plays", min_length=1, max_length=64)


def parse_part(text: str) -> EnsemblePart:
    """Read ``NUMBER=INSTRUMENT[@GAINdB][@panPAN]``, e.g. ``2=electric_bass@-3dB@pan-0.3``.

    Raises TonewoodError : one line.
    """
    match = _PART.fullmatch(text.strip())
    values: dict[str, Any] = {}
    words = match["rest"].split("@")[1:] if match else []
    for word in words:
        gain, pan = _GAIN.fullmatch(word.strip()), _PAN.fullmatch(word.strip())
        if (gain is None and pan is None) or ("gain_db" if gain else "pan") in values:
            match = None
        elif gain is not None:
            values["gain_db"] = float(gain[1])
        elif pan is not None:
            values["pan"] = float(pan[1])
    if match is None:
        raise TonewoodError(f"{text!r} is not NUMBER=INSTRUMENT[@GAINdB][@panPAN], e.g. 2=electric_bass@-3dB@pan-0.3")
    values |= {"part": int(match["number"]), "instrument": match["instrument"].strip()}
    return validated(EnsemblePart, values, key="--part")


def read_ensemble(path: str | os.PathLike[str]) -> list[EnsemblePart]:
    """Read an ensemble's YAML file. Raises BundleError : it cannot be read, or a value is not allowed; one line."""
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
    silent: Callable[[EnsemblePart, str], None] | None = None,
    **settings: Any,
) -> list[Stem]:
    """Render the parts of a score, each in a process of its own.

    score : path of a score's file.
    parts : of it, with their instruments.
    fs, options : as for `Renderer`, of all parts; the lead-in is a number.
    workers : processes at a time; as many as there are processors, where left out; 1 renders in this one.
    progress : called with the name of an instrument when its part is done.
    reading : settings of `read_score`, without tracks.
    silent : called with a part of which no note can be played, and the reason; it is then left out. Where it is not
        given, that is an error.
    Returns One stem per part, all of one length; their sum is the mix.
    Raises NothingPlayedError : no note of a part can be played, or of none.
    Raises TonewoodError : a part or an instrument is not there, or has more than two channels; one line.
    """
    options = RenderOptions.of(options, fs, settings)
    if options.lead_in == "auto":
        raise TonewoodError("is auto; parts that begin together need a number of seconds", key="lead_in")
    jobs = [(os.fspath(score), part, options, reading or {}) for part in parts]
    rendered: list[tuple[EnsemblePart, Floats, Summary]] = []
    for part, result in zip(parts, _all_rendered(jobs, workers, progress), strict=True):
        if not isinstance(result, NothingPlayedError):
            rendered.append((part, *result))
        elif silent is None or len(parts) == 1:
            raise result
        else:
            silent(part, result.reason)
    if not rendered:
        raise NothingPlayedError("no note of any part can be played", file=score)
    longest = max(len(samples) for _, samples, _ in rendered)
    stems = []
    for part, samples, summary in rendered:
        out = np.zeros((longest, 2))
        out[: len(samples)] = samples
        stems.append(Stem(part, out, summary))
    return stems


_Job = tuple[str, EnsemblePart, RenderOptions, dict[str, Any]]


def _all_rendered(
    jobs: Sequence[_Job], workers: int | None, progress: Callable[[str], None] | None
) -> Iterator[tuple[Floats, Summary] | NothingPlayedError]:
    """Sound and summary of each part, or why none of its notes can be played."""
    n = min(workers or os.cpu_count() or 1, len(jobs))
    report = progress or (lambda _: None)
    if n == 1:
        for job in jobs:
            try:
                result: tuple[Floats, Summary] | NothingPlayedError = _rendered(*job)
            except NothingPlayedError as error:
                result = error
            report(job[1].instrument)
            yield result
        return
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(n, mp_context=get_context("spawn")) as pool:
        files = [os.path.join(folder, f"{i}.npy") for i in range(len(jobs))]
        waiting = [pool.submit(_to_file, file, *job) for file, job in zip(files, jobs, strict=True)]
        for file, job, done in zip(files, jobs, waiting, strict=True):
            try:
                summary = done.result()
            except BrokenProcessPool:
                raise TonewoodError(f"the process that rendered {job[1].instrument} ended: out of memory?") from None
            except NothingPlayedError as error:
                report(job[1].instrument)
                yield error
                continue
            warn_of_dropped_notes(summary.notes_dropped)
            report(job[1].instrument)
            yield np.load(file), summary


def placed(samples: Floats, part: EnsemblePart, controls: Sequence[Control] = (), fs: float = 1.0) -> Floats:
    """Return a part's sound (n, 2) with its gain and pan, and those of controllers (times in s) at a rate fs (Hz)."""
    n_channels = samples.shape[1]
    courses = {kind: [c for c in controls if c.kind == kind] for kind in MIXED}
    out = samples * (10 ** (part.gain_db / 20) * np.array(pan_gains(part.pan, n_channels)))
    if courses["cc10"]:
        pan = np.clip(part.pan + (_course(courses["cc10"], len(out), fs, 64 / 127) * 127 - 64) / 63, -1.0, 1.0)
        factor = 10 ** (part.gain_db / 20) * (1.0 if n_channels == 1 else math.sqrt(2.0))
        angle = np.pi * (1.0 + pan) / 4.0
        out = samples * factor * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for kind in ("cc7", "cc11"):
        if courses[kind]:
            out *= _course(courses[kind], len(out), fs, 1.0)[:, None] ** 2
    return out


def _course(controls: Sequence[Control], n: int, fs: float, first: float) -> Floats:
    """Values of a controller at each of n frames; a change begins at its time and takes `GLIDE` s."""
    times, values, latest = [0.0], [first], first
    for control in sorted(controls, key=lambda c: c.time):
        if control.time <= 0.0:
            values = [control.value]
        else:
            begin = max(control.time, times[-1])
            times += [begin, begin + GLIDE]
            values += [latest, control.value]
        latest = control.value
    course: Floats = np.interp(np.arange(n) / fs, times, values)
    return course


def by_programs(score: Score, programs: Sequence[int] | None) -> Score:
    """Notes of some programs of General MIDI; a note that has none is of program 1."""
    if programs is None:
        return score
    return replace(score, notes=[note for note in score.notes if (note.program or 1) in programs])


def _rendered(
    score: str, part: EnsemblePart, options: RenderOptions, reading: dict[str, Any]
) -> tuple[Floats, Summary]:
    from tonewood.instrument.bundle.loading import Instrument

    instrument = Instrument.load(part.instrument).replace(part.set)
    music = read_score(score, tracks=[part.part], **reading)
    music = by_programs(music, part.programs)
    if part.programs is not None:
        music = replace(music, ignored={k: n for k, n in music.ignored.items() if k != "program change"})
    used = {*instrument.spec.playing.controls, *instrument.spec.playing.switches}
    mixed = [c for c in music.controls if c.kind in MIXED and c.kind not in used]
    music = replace(music, controls=[c for c in music.controls if c not in mixed] if mixed else music.controls)
    where = f"part {part.part} on {part.instrument}"
    if not music.notes:
        raise NothingPlayedError(f"{where}: there are no notes to play", file=score)
    try:
        renderer = Renderer(music, instrument, options=options)
    except NothingPlayedError as error:
        raise NothingPlayedError(f"{where}: {error.reason}", file=score) from None
    n = len(renderer.channels)
    if n > 2:
        raise TonewoodError(f"{part.instrument} has {n} channels; choose one or two by outputs", key="outputs")
    blocks = list(renderer.blocks(4096))
    samples = np.concatenate(blocks) if blocks else np.zeros((0, n))
    late = renderer.zero_frame / renderer.fs
    controls = [replace(c, time=c.time + late) for c in mixed if c.channel in (part.part - 1, None)]
    sound, summary = placed(samples, part, controls, renderer.fs), renderer.summary()
    unheard = silence(float(np.max(np.abs(sound), initial=0.0)), ended=True)
    # a part that sounds is silent in the mix where its controllers turn it down
    return sound, replace(summary, warnings=tuple(dict.fromkeys([*summary.warnings, *unheard])))


def _to_file(file: str, score: str, part: EnsemblePart, options: RenderOptions, reading: dict[str, Any]) -> Summary:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)  # the process that asked for the part issues it
        samples, summary = _rendered(score, part, options, reading)
    try:
        np.save(file, samples)
    except OSError as fault:  # NumPy gives no reason where its file is cut short
        reason = fault.strerror or "is the disk full?"
        raise OutputError(f"the part cannot be kept until the mix: {reason}", file=file) from None
    return replace(summary, effects=())
