"""Making the sound files: measure every sound, set the length and level of each group, write.

Two passes over the finished renders, both free to run many at once: the first finds each sound's length, gain and true
peak, the second writes the files. Between them each group gets the length of its longest sound, and one that would pass
the true-peak limit is lowered as a whole.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.support.sound_rates import read_samples
from tonewood.support.whole_files import whole_file
from tonewood.workshop.batch import stimuli as st
from tonewood.workshop.batch import trimming
from tonewood.workshop.batch.layout import ANCHOR_ROLES, Group, Stimulus
from tonewood.workshop.batch.manifest import Loudness, Stimuli
from tonewood.workshop.batch.pictures import write_picture
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.batch.store import Rendered, Store
from tonewood.workshop.batch.workers import Workers

SOUNDS = "stimuli"
PICTURES = "pictures"
#: s of noise in a trial
_TRIAL = 4
#: time of a file re that of a trial: reading the render, resampling, fades, writing
_FILE_SHARE = 1.5
_PICTURE_SECONDS = 0.15
#: of a core, for a worker process to import all that it needs
_START_SECONDS = 3.0
_CUTOFF = {role: cutoff for cutoff, role in ANCHOR_ROLES.items()}


@dataclass(frozen=True)
class _Job:
    """One file to be made; everything a worker needs."""

    stimulus: Stimulus
    group: str
    render: Path
    key: str
    settings: Stimuli
    room: Path | None
    seed: int


@dataclass(frozen=True)
class _Level:
    """Result of the first pass: length, gain of the sound alone and true peak with it, or why there is none."""

    code: str
    frames: int
    gain_db: float
    true_peak_dbtp: float
    fault: str | None = None


@dataclass(frozen=True)
class SoundFile:
    """A written file with its measurements."""

    code: str
    group: str
    condition: str
    role: str
    key: str
    file: str
    fs: int
    channels: int
    subtype: str
    frames: int
    gain_db: float
    page_drop_db: float
    lufs: float | None
    momentary_lufs: float | None
    loudness_gated: bool
    peak_dbfs: float | None
    true_peak_dbtp: float | None
    sha256: str


@dataclass(frozen=True)
class Fault:
    """A sound that could not be made; the rest went on."""

    name: str
    reason: str
    detail: str = ""


def make_files(
    groups: Sequence[Group],
    keys: dict[str, str],
    store: Store,
    settings: Stimuli,
    folder: Path,
    workers: Workers,
    *,
    room: Path | None = None,
    seed: int,
    pictures: bool,
    advance: Callable[[], None],
) -> tuple[list[SoundFile], list[Fault], list[str]]:
    """Write the files of all groups.

    groups : with stimuli whose condition is in `keys` only.
    keys : content key of each condition's render in `store`.
    folder : the batch's output folder.
    room : file of the impulse response of `settings`.
    advance : called twice per file.
    Returns files, faults, notes : in the order of `groups`; notes tell which groups were lowered.
    """
    jobs = [_Job(s, g.name, store.folder, keys[s.condition], settings, room, seed) for g in groups for s in g.stimuli]
    levels: dict[str, _Level] = {}
    for level in workers.each(_find_level, jobs):
        levels[level.code] = level
        advance()
    faults = [Fault(j.stimulus.condition, f) for j in jobs if (f := levels[j.stimulus.code].fault)]
    drops, notes = _drops(groups, levels, settings)
    lengths = {g.name: group_length([levels[s.code].frames for s in g.stimuli], settings) for g in groups}
    tasks = []
    for job in jobs:
        level, drop = levels[job.stimulus.code], drops[job.group]
        if level.fault is None:
            tasks.append((job, lengths[job.group], level.gain_db - drop, drop, folder, pictures))
    files: dict[str, SoundFile] = {}
    for file in workers.each(_write, tasks):
        files[file.code] = file
        advance()
    return [files[j.stimulus.code] for j in jobs if j.stimulus.code in files], faults, notes


def level_settings(loudness: Loudness) -> tuple[str, float, float]:
    """Settings of `stimuli.level_gain_db`."""
    return loudness.method, loudness.target_lufs, loudness.window


def group_length(frames: Sequence[int], settings: Stimuli) -> int:
    """Samples of every file of a group, given the lengths of its sounds."""
    return max(frames, default=1) if settings.duration == "page_max" else longest(settings)


def longest(settings: Stimuli) -> int:
    """Samples of the longest file that is allowed."""
    seconds = settings.longest if settings.duration == "page_max" else settings.duration
    return max(1, round(seconds * settings.fs))


def prepared(rendered: Rendered, settings: Stimuli, role: str = "sound", room: Path | None = None) -> st.Samples:
    """A render at the files' rate and channels, aligned, trimmed and faded; low-passed if it is an anchor."""
    audio = st.resampled(rendered.samples, rendered.fs, settings.fs)
    if room is None:
        audio = st.with_channels(audio, settings.channels, settings.downmix)
    else:
        response = room_response(room, settings)
        dry = st.with_channels(audio, audio.shape[1] if audio.shape[1] == settings.channels else 1, settings.downmix)
        audio = trimming.convolved(dry, response)
    lead = round(settings.onset.at * settings.fs)
    onset = trimming.onset(audio, settings.onset.level_db) if settings.onset.align == "detected" else 0
    audio = trimming.shifted(audio, lead - onset)[: longest(settings)]
    if settings.trim.level_db is not None:
        audio = audio[: trimming.end(audio, max(1, round(settings.trim.block * settings.fs)), settings.trim.level_db)]
    if role in _CUTOFF:
        audio = st.anchor(audio, settings.fs, _CUTOFF[role])
    return st.faded(audio, settings.fs, settings.fade.in_, settings.fade.out)


def levelled(rendered: Rendered, settings: Stimuli, room: Path | None = None) -> st.Samples:
    """A prepared sound at its loudness. Raises TonewoodError : it is silent, or has other channels."""
    sound = prepared(rendered, settings, room=room)
    gain = st.level_gain_db(sound, settings.fs, *level_settings(settings.loudness))
    return np.asarray(sound * 10.0 ** (gain / 20.0), dtype=np.float64)


def level_faults(
    levels: Mapping[str, str | None], store: Store, settings: Stimuli, room: Path | None
) -> Iterator[Fault]:
    """Levels of staircases (name -> key of the render) that cannot be brought to the loudness of the others."""
    for name, key in levels.items():
        try:
            if key is not None:
                levelled(store.load(key), settings, room)
        except TonewoodError as fault:
            yield Fault(name, str(fault))


@cache
def room_response(path: Path, settings: Stimuli) -> st.Samples:
    """The impulse response of a room at the files' rate, (n, 1 or `channels`).

    Raises StimulusError : the file cannot be read, has other channels, or holds no sound or numbers that are not
        finite.
    """
    import soundfile

    try:
        samples, fs = read_samples(path)
    except OSError as fault:
        raise st.StimulusError(f"cannot be read: {fault.strerror or fault}", file=path) from None
    except soundfile.LibsndfileError as fault:
        raise st.StimulusError(f"cannot be read: {fault.error_string}", file=path) from None
    if not (samples.any() and np.isfinite(samples).all()):
        raise st.StimulusError("is silent, or holds a number that is not finite", file=path)
    if samples.shape[1] not in (1, settings.channels):
        raise st.StimulusError(f"has {samples.shape[1]} channels; 1 or {settings.channels} are allowed", file=path)
    return st.resampled(samples, int(fs), settings.fs)


def _find_level(job: _Job) -> _Level:
    code, settings, role = job.stimulus.code, job.settings, job.stimulus.role
    try:
        rendered = Store(job.render).load(job.key)
        sound = prepared(rendered, settings, room=job.room)
        # an anchor has the gain of the sound it is made of
        gain = st.level_gain_db(sound, settings.fs, *level_settings(settings.loudness))
        if role in _CUTOFF:
            sound = prepared(rendered, settings, role, job.room)
        peak = st.true_peak(sound)
    except TonewoodError as fault:
        return _Level(code, 1, 0.0, -math.inf, str(fault))
    return _Level(code, len(sound), gain, gain + 20.0 * math.log10(peak) if peak > 0 else -math.inf)


def _drops(groups: Iterable[Group], levels: dict[str, _Level], settings: Stimuli) -> tuple[dict[str, float], list[str]]:
    drops, notes = {}, []
    limit = settings.loudness.true_peak_dbtp
    for group in groups:
        drops[group.name] = drop = st.page_drop_db([levels[s.code].true_peak_dbtp for s in group.stimuli], limit)
        if drop > 0:
            notes.append(f"{group.name}: all files lowered by {drop:.2f} dB to keep true peaks below {limit} dBTP")
    return drops, notes


def _write(task: tuple[_Job, int, float, float, Path, bool]) -> SoundFile:
    job, length, gain, drop, folder, pictures = task
    settings, code, role = job.settings, job.stimulus.code, job.stimulus.role
    audio = prepared(Store(job.render).load(job.key), settings, role, job.room) * 10.0 ** (gain / 20.0)
    audio = np.pad(audio, ((0, length - len(audio)), (0, 0)))
    random = generator(job.seed, "dither", job.group, job.stimulus.condition, role)
    samples = st.quantised(audio, settings.subtype, random)
    file = f"{SOUNDS}/{code}.wav"
    write_wav(folder / file, samples, settings.fs, settings.subtype)
    heard = samples / 2.0 ** (st.BITS[settings.subtype] - 1)
    if pictures:
        write_picture(folder / PICTURES / f"{code}.png", heard, settings.fs)
    measured = st.measured(heard, settings.fs)
    return SoundFile(
        code=code,
        group=job.group,
        condition=job.stimulus.condition,
        role=role,
        key=job.key,
        file=file,
        fs=settings.fs,
        channels=samples.shape[1],
        subtype=settings.subtype,
        frames=len(samples),
        gain_db=gain,
        page_drop_db=drop,
        lufs=_finite(measured.lufs),
        momentary_lufs=_finite(measured.momentary_lufs),
        loudness_gated=measured.gated,
        peak_dbfs=_finite(measured.peak_dbfs),
        true_peak_dbtp=_finite(measured.true_peak_dbtp),
        sha256=st.samples_sha256(samples),
    )


def trial_of_a_file(settings: Stimuli, *, pictures: bool) -> tuple[float, float]:
    """Time to measure and write one sound file, s, and to start workers, s, from trials on noise under today's load."""
    noise = np.random.default_rng(0).standard_normal((_TRIAL * settings.fs, settings.channels)) * 0.01

    def trial() -> None:
        heard = noise * 10.0 ** (st.level_gain_db(noise, settings.fs, *level_settings(settings.loudness)) / 20.0)
        st.true_peak(heard)
        st.quantised(heard, settings.subtype, np.random.default_rng(0))
        st.measured(heard, settings.fs)

    trial()  # imports
    began, computed = time.perf_counter(), time.process_time()
    trial()
    trial()
    seconds, share = time.perf_counter() - began, time.process_time() - computed
    file = 0.5 * seconds * _FILE_SHARE + (_PICTURE_SECONDS if pictures else 0.0)
    return file, _START_SECONDS * max(1.0, seconds / max(share, 1e-9))


def write_wav(path: Path, samples: Any, fs: int, subtype: str) -> None:
    """Write integer samples as they are; the file's bytes depend on nothing else."""
    with whole_file(path, make_folder=True) as stream:
        encoded_wav(stream, samples, fs, subtype)


def encoded_wav(stream: BinaryIO, samples: Any, fs: int, subtype: str) -> None:
    """Write integer samples as a WAV file into a stream."""
    import soundfile

    whole = samples if subtype == "PCM_16" else samples << 8  # soundfile wants 24 bits at the top of 32
    soundfile.write(stream, whole, fs, subtype=subtype, format="WAV")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
