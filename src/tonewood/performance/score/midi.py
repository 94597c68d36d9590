"""MIDI files to scores and back: tempo, keys and pedals, controllers, bends, excerpts.

Decisions where the format leaves a choice, or files are often wrong:

- Format 2 holds independent patterns: they are played one after the other, each with its own tempo map.
- The k-th note-off of a key ends the k-th note-on still held; striking a key again ends a note that only the pedal
  holds.
- Notes shorter than `MIN_DURATION` are lengthened to it, longer than `MAX_DURATION` shortened to it: nothing plucked
  sounds longer.
- Silence longer than `LONG_GAP` is reported; `MAX_SILENCE` of it in all is refused, and so is a piece beyond
  `MAX_TIME`. An excerpt (`start`, `stop`) is judged by itself, so it is always a way out.
- Notes of channel 10 are percussion by General MIDI: left out, and counted, unless they are asked for.
- Pressure on single keys and system exclusive messages have no effect; they are counted in `Score.ignored`.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from operator import itemgetter
from pathlib import Path

from tonewood.errors import ScoreError
from tonewood.performance.score.channel_reader import ChannelReader, where
from tonewood.performance.score.file_bytes import file_bytes
from tonewood.performance.score.note import Beats, Control, Note, Score, ScorePart
from tonewood.performance.score.smf import Findings, MidiFile, Track, parse_smf
from tonewood.support.whole_files import whole_file

MAX_BYTES = 16 * 2**20
MAX_NOTES = 200_000
MIN_DURATION = 0.02
MAX_DURATION = 600.0
LONG_GAP = 60.0
MAX_SILENCE = 900.0
MAX_TIME = 6 * 3600.0
#: channel of percussion, from 0
_DRUMS = 9


def read_midi(
    path: str | os.PathLike[str], *, start: float = 0.0, stop: float | None = None, percussion: bool = False
) -> Score:
    """Read a Standard MIDI File (format 0, 1, 2, or in a RIFF RMID wrapper).

    Parameters
    ----------
    path : the file.
    start, stop : s, the excerpt to read: notes that begin in it, ended at `stop`, with times counted from `start`
        and every controller at the value it has there.
    percussion : read notes of channel 10, which General MIDI gives to percussion, as pitches.

    Returns
    -------
    score : notes with `time`, `duration` (sustain pedal included), `note`, `velocity_midi`, `channel`, `program`;
        controls ``bend`` in cents (range by registered parameter 0) and ``ccN`` from 0 to 1, per channel, only changes;
        one warning per kind of oddity.

    Raises
    ------
    ScoreError : one line, if the file cannot be read, or there would be more notes, time or silence than the limits
        of this module allow, or its faults leave no note at all. (A sound file without notes is an empty score.)
    """
    path = Path(path)
    if not (0.0 <= start < (math.inf if stop is None else stop)):
        raise ScoreError(f"excerpt from {start} s to {stop} s: 0 <= start < stop is needed", file=path)
    findings = Findings()
    midi = parse_smf(file_bytes(path, MAX_BYTES), findings, file=os.fspath(path))
    performance = ChannelReader(findings, path, percussion=percussion)
    for messages, end in _played(midi, findings):
        performance.play(messages)
        performance.finish(end)
        if len(performance.notes) > MAX_NOTES:
            raise ScoreError(f"{len(performance.notes)} notes: {MAX_NOTES} are allowed", file=path)
    notes, controls = _excerpt(performance, start, stop, findings)
    _check_time(notes, path, findings)
    warnings = findings.lines()
    if not performance.notes and warnings:
        raise ScoreError(f"no notes in the file ({'; '.join(warnings)})", file=path)
    until = math.inf if stop is None else stop
    ignored = Counter(kind for time, kind in performance.ignored if start <= time < until)
    return Score(
        notes, controls, warnings=warnings, name=path.stem, metadata=_texts(midi), ignored=ignored, file=str(path),
        parts=_parts(notes, performance), beats=_beats(midi) if start == 0.0 else None,
    )  # fmt: skip


def _beats(midi: MidiFile) -> Beats | None:
    """Quarter notes of a file whose tracks sound together and whose ticks divide them."""
    if midi.format == 2 or midi.tick_s is not None:
        return None
    seconds, unit = _clock(midi, midi.tracks), midi.ticks_per_quarter
    changes = dict(sorted(chain.from_iterable(t.tempos for t in midi.tracks), key=itemgetter(0)))
    tempos = [(seconds(tick), tick / unit, 60e6 / tempo) for tick, tempo in sorted({0: 500_000, **changes}.items())]
    signs = {tick: 4.0 * over / under for t in midi.tracks for tick, over, under in t.meters}
    return Beats(tempos, [(tick / unit, length) for tick, length in sorted({0: 4.0, **signs}.items())])


def _parts(notes: Sequence[Note], performance: ChannelReader) -> tuple[ScorePart, ...]:
    """Channels that have notes; those of a zone of MPE are one part, named by its master."""
    master = {member: of for of, members in performance.zones.items() for member in members}
    by_master: dict[int, dict[int, Counter[int | None]]] = {}
    for note in notes:
        at = note.channel or 0
        by_master.setdefault(master.get(at, at), {}).setdefault(at, Counter())[note.program] += 1
    if performance.n_drums:
        by_master.setdefault(_DRUMS, {})
    return tuple(
        ScorePart(
            number + 1,
            channels=tuple(at + 1 for at in sorted(by_channel) if at != number),
            programs=sum(by_channel.values(), Counter()),
            n_drums=performance.n_drums if number == _DRUMS else 0,
        )
        for number, by_channel in sorted(by_master.items())
    )


def read_messages(path: str | os.PathLike[str]) -> tuple[list[tuple[float, int, int, int]], float, dict[str, str]]:
    """Read the channel messages of a Standard MIDI File, as an instrument that is played live receives them.

    Returns messages : (time in s, status, data 1, data 2), in time order.
    end : s, of the last track.
    texts : as `Score.metadata`.
    Raises ScoreError : one line, if the file cannot be read.
    """
    path, findings = Path(path), Findings()
    midi = parse_smf(file_bytes(path, MAX_BYTES), findings, file=os.fspath(path))
    messages: list[tuple[float, int, int, int]] = []
    end = 0.0
    for pattern, until in _played(midi, findings):
        messages += pattern
        end = until
    if end > MAX_TIME:
        raise ScoreError(f"{end:.0f} s of music: {MAX_TIME:.0f} s are allowed", file=path)
    return messages, end, _texts(midi)


def _played(midi: MidiFile, findings: Findings) -> Iterator[tuple[Iterator[tuple[float, int, int, int]], float]]:
    """Yield the messages of each pattern, (time in s, status, data 1, data 2), and the time of its end."""
    began = 0.0
    for pattern in _patterns(midi, findings):
        end = began + _clock(midi, pattern)(max(t.end for t in pattern))
        yield _timed(pattern, began, _clock(midi, pattern)), end
        began = end


def _timed(
    pattern: Sequence[Track], began: float, seconds: Callable[[int], float]
) -> Iterator[tuple[float, int, int, int]]:
    for tick, status, a, b in sorted(chain.from_iterable(t.messages for t in pattern), key=itemgetter(0)):
        yield began + seconds(tick), status, a, b


def _texts(midi: MidiFile) -> dict[str, str]:
    texts: dict[str, str] = {}
    for track in midi.tracks:
        texts = {**track.texts, **texts}
    return texts


def _patterns(midi: MidiFile, findings: Findings) -> list[list[Track]]:
    """Tracks that sound together, in the order in which they are played."""
    if midi.format < 2:
        return [midi.tracks]
    if len(midi.tracks) > 1:
        findings.add(f"format 2: its {len(midi.tracks)} independent tracks are played one after the other")
    return [[track] for track in midi.tracks]


def _clock(midi: MidiFile, tracks: Sequence[Track]) -> Callable[[int], float]:
    """Seconds from the start of the pattern as a function of the tick, for ticks asked in rising order.

    t(n) = t(n_i) + (n − n_i) · tempo_i / (10⁶ · ticks_per_quarter)   from the tempo event i at tick n_i on
    """
    if midi.tick_s is not None:
        tick_s = float(midi.tick_s)
        return lambda tick: tick * tick_s
    tempos = sorted(chain.from_iterable(t.tempos for t in tracks), key=itemgetter(0))
    scale = 1e-6 / midi.ticks_per_quarter
    due = 0
    base_tick, base_time, tempo = 0, 0.0, 500_000

    def seconds(tick: int) -> float:
        nonlocal due, base_tick, base_time, tempo
        while due < len(tempos) and tempos[due][0] <= tick:
            base_time += (tempos[due][0] - base_tick) * tempo * scale
            base_tick, tempo = tempos[due]
            due += 1
        return base_time + (tick - base_tick) * tempo * scale

    return seconds


def _excerpt(
    performance: ChannelReader, start: float, stop: float | None, findings: Findings
) -> tuple[tuple[Note, ...], tuple[Control, ...]]:
    stop = math.inf if stop is None else stop
    notes = []
    timed = zip(performance.notes, performance.ends, performance.releases, performance.programs, strict=True)
    for (time, channel, key, velocity), end, release, program in timed:
        if not start <= time < stop:
            if time < start < end:
                findings.add("note begun before the excerpt, left out", where(channel, key, time))
            continue
        duration = end - time
        if duration < MIN_DURATION:
            findings.add(f"note shorter than {MIN_DURATION} s, lengthened to it", where(channel, key, time))
        elif duration > MAX_DURATION:
            findings.add(f"note longer than {MAX_DURATION:.0f} s, shortened to it", where(channel, key, time))
        duration = min(max(min(end, stop) - time, MIN_DURATION), MAX_DURATION)
        down = max(release - time, MIN_DURATION) if release < min(end, stop) else None
        notes.append(
            Note(
                time - start, duration, note=key, velocity_midi=velocity, channel=channel, held=down, program=program
            )
        )  # fmt: skip
    before = {(c.kind, c.channel): replace(c, time=0.0) for c in performance.controls if c.time < start}
    within = (c for c in performance.controls if start <= c.time < stop)
    within = (replace(c, time=c.time - start) for c in within) if start else within
    return tuple(notes), (*before.values(), *within)


def _check_time(notes: Sequence[Note], path: Path, findings: Findings) -> None:
    """Report silence between notes, and refuse too much of it, or too long a piece."""
    silence = sounding = 0.0
    way_out = "tw.read_midi reads an excerpt with start and stop"
    for note in notes:
        gap = note.time - sounding
        if gap > LONG_GAP:
            silence += gap
            location = f"{gap:.0f} s before the note at {note.time:.0f} s"
            findings.add("long silence", location)
            if silence > MAX_SILENCE:
                raise ScoreError(
                    f"too much silence, {location}: {MAX_SILENCE:.0f} s in all are allowed; {way_out}", file=path
                )
        sounding = max(sounding, note.time + note.duration)
    if sounding > MAX_TIME:
        raise ScoreError(f"{sounding:.0f} s of music: {MAX_TIME:.0f} s are allowed; {way_out}", file=path)


def write_midi(score: Score, path: str | os.PathLike[str], *, bpm: float = 120.0, ticks_per_beat: int = 960) -> None:
    """Write notes, bends and controllers as a format 1 file: a track of tempo, then one per channel.

    Times are rounded to the tick, 60 / (bpm · ticks_per_beat) s; choose `bpm` so that the beats of the piece fall on
    ticks. A note needs a whole MIDI number in `note`; `velocity_midi` None is written as 80, `channel` None as the
    first. String, force, place and technique have no MIDI message and are not written.

    Parameters
    ----------
    score, path : the score, and the file to write.
    bpm : beats per minute.
    ticks_per_beat : of the file.

    Raises
    ------
    ScoreError : a note or control that MIDI has no number for.
    OutputError : the file cannot be written.
    """
    import mido

    rate = bpm / 60 * ticks_per_beat
    widest = max((abs(c.value) for c in score.controls if c.kind == "bend"), default=0.0)
    semitones = math.ceil(max(2.0, min(widest / 100, 128.0)))
    # sorted by tick, then: controllers, note-offs, note-ons
    timed: dict[int, list[tuple[int, int, mido.Message]]] = {}
    for control in score.controls:
        number = control.channel or 0
        event = _control_message(control, number, semitones, path)
        timed.setdefault(number, []).append((round(control.time * rate), 0, event))
    for note in score.notes:
        key, velocity, number = note.note, round(note.velocity_midi or 80), note.channel or 0
        if key is None or key != int(key) or not 0 <= key <= 127:
            raise ScoreError(f"note {key} at {note.time:.3f} s: MIDI needs a whole number from 0 to 127", file=path)
        begin = round(note.time * rate)
        end = max(round(note.key_up * rate), begin + 1)
        on = mido.Message("note_on", channel=number, note=int(key), velocity=max(velocity, 1))
        off = mido.Message("note_off", channel=number, note=int(key), velocity=64)
        timed.setdefault(number, []).extend([(begin, 2, on), (end, 1, off)])

    file = mido.MidiFile(type=1, ticks_per_beat=ticks_per_beat, charset="utf-8")
    head = mido.MidiTrack([mido.MetaMessage("track_name", name=score.metadata.get("title", score.name))])
    head.append(mido.MetaMessage("set_tempo", tempo=mido.bpm2tempo(bpm)))
    file.tracks.append(head)
    for number, events in sorted(timed.items()):
        track = mido.MidiTrack()
        if any(e.type == "pitchwheel" for _, _, e in events):
            for cc, value in ((101, 0), (100, 0), (6, semitones), (38, 0), (101, 127), (100, 127)):
                track.append(mido.Message("control_change", channel=number, control=cc, value=value))
        now = 0
        for tick, _, event in sorted(events, key=itemgetter(0, 1)):
            track.append(event.copy(time=tick - now))
            now = tick
        file.tracks.append(track)
    with whole_file(path) as stream:
        file.save(file=stream)


def _control_message(control: Control, number: int, semitones: int, path: str | os.PathLike[str]) -> object:
    import mido

    if control.kind == "bend" and semitones <= 127:
        pitch = round(control.value / (100 * semitones) * 8192)
        return mido.Message("pitchwheel", channel=number, pitch=min(pitch, 8191))
    if control.kind == "channel_pressure":
        return mido.Message("aftertouch", channel=number, value=round(control.value * 127))
    cc = control.kind[2:]
    if control.kind.startswith("cc") and cc.isdecimal() and int(cc) < 120 and 0 <= control.value <= 1:
        return mido.Message("control_change", channel=number, control=int(cc), value=round(control.value * 127))
    raise ScoreError(f"control {control.kind} = {control.value}: MIDI has no message for it", file=path)
