"""A sample library of an instrument: renders its strokes, writes them and the texts that samplers read."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from tonewood.errors import OutputError, TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.sound.files.audio import Audio, decibels, not_held
from tonewood.sound.files.tags import Tags
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled
from tonewood.support.text_files import one_line
from tonewood.support.whole_files import AtomicFile
from tonewood.workshop.batch.workers import Workers
from tonewood.workshop.sampling.notes import Span, compass, key_spans, sample_name, velocity_spans
from tonewood.workshop.sampling.strokes import Stroke, release, ringing, rings
from tonewood.workshop.sampling.texts import Region, decent_text, sfz_text

#: dBFS of the loudest sample of a library
_PEAK = -1.0


class Tell(Protocol):
    """Hears of the work that is done."""

    def __call__(self, share: float, /) -> object:
        """Take the share, 0 to 1."""


@dataclass(frozen=True)
class Sampling:
    """Strokes that a library holds.

    step : semitones between sampled keys.
    repeats : strokes of one key and velocity that a sampler plays in turn.
    lowest, highest : keys; those of the instrument where they are None.
    duration : s, of a sample at most.
    releases : whether the end of a note has samples of its own.
    """

    step: int = 3
    velocities: Sequence[int] = (32, 64, 96, 120)
    repeats: int = 2
    lowest: int | None = None
    highest: int | None = None
    duration: float = 8.0
    releases: bool = True


@dataclass(frozen=True)
class Library:
    """Written files.

    sfz, decent, folder : the texts, and the folder of sound files.
    seconds, size : of sound, and bytes.
    gain_db : from the instrument's calibrated level to that of the files.
    rings : whether notes go on when their keys come up.
    """

    sfz: Path
    decent: Path
    folder: Path
    n_samples: int
    n_releases: int
    seconds: float
    size: int
    gain_db: float
    rings: bool


@dataclass(frozen=True)
class _Task:
    """One stroke to be rendered."""

    keys: Span
    velocities: Span
    repeat: int
    release: bool

    @property
    def name(self) -> str:
        return sample_name(self.keys.centre, self.velocities.centre, self.repeat, release=self.release)


@dataclass
class _Measures:
    """Facts about rendered strokes that the texts need."""

    peak: float = 0.0
    frames: int = 0
    levels: dict[int, dict[int, list[float]]] = field(default_factory=dict)
    decays: dict[int, list[float]] = field(default_factory=dict)
    recordings: dict[str, tuple[_Task, Path]] = field(default_factory=dict)


def make_library(
    instrument: Instrument,
    path: str | os.PathLike[str],
    sampling: Sampling,
    options: RenderOptions,
    *,
    jobs: int = 1,
    suffix: str = ".flac",
    tell: Tell = lambda share: None,
) -> Library:
    """Render an instrument's notes and write them as a sample library.

    path : of the SFZ file; beside it go a folder of its name with the samples, and the preset of Decent Sampler.
    options : of the renders; `max_duration` is the sampling's.
    jobs : worker processes; -1 for one per core.
    suffix : of the sound files, ``.flac`` or ``.wav``.
    Raises OutputError : the path has another suffix than ``.sfz``, or one of the files is there already.
    Raises TonewoodError : the sampling asks for keys, velocities or counts that are not allowed.
    """
    sfz, folder, decent = _targets(Path(path))
    options = options.at(max_duration=sampling.duration, tail=sampling.duration)
    if sampling.repeats > 1 and options.humanize is None and instrument.spec.playing.variation.seed is None:
        options = options.at(humanize=1)  # or strokes that are played in turn would be the same
    tasks = _tasks(instrument, sampling, options)
    if reason := not_held(suffix[1:].upper(), options.fs):
        raise OutputError(reason, file=sfz)
    try:
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=sfz.absolute().parent))
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=sfz) from None
    try:
        measures = _Measures()
        render = partial(_rendered, instrument, options, scratch)
        for done, outcome in enumerate(_each(render, tasks, jobs), 1):
            _enter(measures, options.fs, *outcome)
            tell(done / len(tasks))
        if measures.peak == 0.0:
            raise OutputError("every stroke is silent", file=sfz)
        regions = [_region(task, measures, suffix) for task, _ in measures.recordings.values()]
        # a stroke harder than those rendered is the loudest one, raised by its region's gain
        above = max(r.volume_db for r in regions if r.decay_db is None)
        gain_db = _PEAK - decibels(measures.peak) - max(0.0, above)
        tags = Tags.of(None, [instrument])
        for task, raw in measures.recordings.values():
            scaled = np.load(raw) * 10 ** (gain_db / 20)
            Audio(scaled, options.fs, tags=tags).save(scratch / f"{task.name}{suffix}", "PCM_24")
            raw.unlink()
        regions.sort(key=lambda r: (r.decay_db is not None, r.keys.centre, r.velocities.centre, r.repeat))
        _about(instrument, scratch / "README.txt")
        size = sum(file.stat().st_size for file in scratch.iterdir())
        files = []
        for target, text_of in ((sfz, sfz_text), (decent, decent_text)):
            text = text_of(regions, folder.name, _head(instrument, gain_db), rings=rings(instrument))
            files.append(AtomicFile(target))
            files[-1].path.write_text(text, encoding="utf-8")
        scratch.chmod(0o755)
        scratch.rename(folder)
        for file in files:
            file.complete()
    except BaseException as fault:
        if not scratch.exists():  # it has its name already: none of the three was there before
            shutil.rmtree(folder, ignore_errors=True)
            sfz.unlink(missing_ok=True)
            decent.unlink(missing_ok=True)
        shutil.rmtree(scratch, ignore_errors=True)
        if isinstance(fault, OSError):
            # NumPy gives no reason where a file of its own is cut short
            raise OutputError(f"cannot be written: {fault.strerror or 'is the disk full?'}", file=sfz) from None
        raise
    n_releases = sum(r.decay_db is not None for r in regions)
    seconds = measures.frames / options.fs
    return Library(
        sfz, decent, folder, len(regions) - n_releases, n_releases, seconds, size, gain_db, rings(instrument)
    )


def _targets(sfz: Path) -> tuple[Path, Path, Path]:
    """The SFZ file, the folder of its samples and the other preset; raises OutputError where they cannot be made."""
    folder, decent = sfz.with_suffix(""), sfz.with_suffix(".dspreset")
    if sfz.suffix.lower() != ".sfz":
        raise OutputError(f"has the suffix {sfz.suffix!r}; .sfz is allowed", file=sfz)
    if re.search(r"[<>$\\\x00-\x1f\x7f]|\s\w+=", folder.name):
        reason = "holds < > $ \\ ' WORD=' or a control character, which SFZ takes for its own; give another name"
        raise OutputError(reason, file=sfz)
    for target in (sfz, folder, decent):
        if target.exists():
            raise OutputError("is there already; give another name", file=target)
    if not sfz.absolute().parent.is_dir():
        raise OutputError(f"there is no folder {str(sfz.parent)!r}", file=sfz)
    return sfz, folder, decent


def _tasks(instrument: Instrument, sampling: Sampling, options: RenderOptions) -> list[_Task]:
    """Return all strokes, checked."""
    low, high = compass(assembled(instrument, options))
    first = low if sampling.lowest is None else sampling.lowest
    last = high if sampling.highest is None else sampling.highest
    if not low <= first <= last <= high:
        raise TonewoodError(f"is {first} to {last}; keys from {low} to {high} are allowed", key="range")
    if not 1 <= sampling.step <= 24:
        raise TonewoodError(f"is {sampling.step}; 1 to 24 semitones are allowed", key="every")
    if not 1 <= sampling.repeats <= 16:
        raise TonewoodError(f"is {sampling.repeats}; 1 to 16 are allowed", key="round-robins")
    keys, layers = key_spans(first, last, sampling.step), velocity_spans(sampling.velocities)
    tasks = [_Task(k, v, r, False) for k in keys for v in layers for r in range(1, sampling.repeats + 1)]
    if sampling.releases and not rings(instrument):
        middle = layers[len(layers) // 2]
        everywhere = Span(middle.centre, 1, 127)
        tasks += [_Task(k, everywhere, r, True) for k in keys for r in range(1, sampling.repeats + 1)]
    return tasks


def _each(
    render: Callable[[_Task], tuple[_Task, Stroke, Path]], tasks: Sequence[_Task], jobs: int
) -> Iterator[tuple[_Task, Stroke, Path]]:
    """Render in this process, or in several."""
    return map(render, tasks) if jobs == 1 else Workers(jobs).each(render, tasks)


def _rendered(instrument: Instrument, options: RenderOptions, folder: Path, task: _Task) -> tuple[_Task, Stroke, Path]:
    """Render a stroke and store it in double precision, so that one gain can be given to all."""
    key, velocity = task.keys.centre, task.velocities.centre
    stroke = (release if task.release else ringing)(instrument, options, key, velocity, task.repeat)
    raw = folder / f"{task.name}.npy"
    np.save(raw, stroke.samples)
    return task, stroke, raw


def _enter(measures: _Measures, fs: int, task: _Task, stroke: Stroke, raw: Path) -> None:
    """Measure a stroke."""
    measures.peak = max(measures.peak, stroke.peak)
    measures.frames += len(stroke.samples)
    measures.recordings[task.name] = (task, raw)
    if not task.release:
        measures.levels.setdefault(task.keys.centre, {}).setdefault(task.velocities.centre, []).append(
            stroke.level_db(fs)
        )
        measures.decays.setdefault(task.keys.centre, []).append(stroke.decay_db(fs))


def _region(task: _Task, measures: _Measures, suffix: str) -> Region:
    key = task.keys.centre
    levels = {v: sum(values) / len(values) for v, values in measures.levels[key].items()}
    decay = sum(measures.decays[key]) / len(measures.decays[key]) if task.release else None
    repeats = [t.repeat for t, _ in measures.recordings.values() if (t.keys, t.velocities, t.release) == _place(task)]
    return Region(
        f"{task.name}{suffix}", task.keys, task.velocities, sorted(repeats).index(task.repeat) + 1, len(repeats),
        levels, decay,
    )  # fmt: skip


def _place(task: _Task) -> tuple[Span, Span, bool]:
    return task.keys, task.velocities, task.release


def _head(instrument: Instrument, gain_db: float) -> list[str]:
    """Lines at the head of the texts."""
    spec = instrument.spec
    return [
        one_line(spec.title),
        one_line(f"rendered by tonewood from the instrument {spec.name}, licence {spec.licence}"),
        f"all samples {gain_db:+.2f} dB re the instrument's calibrated level",
    ]


def _about(instrument: Instrument, path: Path) -> None:
    """Write where the samples come from, beside them."""
    spec = instrument.spec
    lines = [f"Samples of {spec.title}.", f"Licence of the instrument: {spec.licence}.", ""]
    lines += [f"Source {name}: {source.text} ({source.licence})" for name, source in spec.sources.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
