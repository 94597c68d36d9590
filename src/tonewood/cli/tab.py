"""``tonewood tab``: the fingering of a score on an instrument, as tablature."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli import common
from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.support.units import counted

#: strings that a tablature has at most
_MOST = 24


def tab(
    score: common.ScorePath,
    instrument: common.InstrumentName,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="tablature: .musicxml (MuseScore and others) or .txt")
    ] = None,
    transpose: common.Transpose = 0.0,
    tracks: common.Tracks = None,
    capo: Annotated[int, typer.Option(help="stop of a capo, 0 for none; frets are counted from it")] = 0,
    meter: Annotated[
        str | None, typer.Option(metavar="N/M", help="measures of this length, e.g. 3/4, in place of the score's")
    ] = None,
    strings: common.StringSetName = None,
    settings: common.Overrides = None,
    allow_code: common.AllowCode = False,
    as_json: common.Json = False,
) -> None:
    """Write the strings, stops and fingers with which SCORE would be played on an instrument, without sound."""
    from tonewood.performance.player.playing import perform, playable
    from tonewood.performance.score.note import Beats
    from tonewood.performance.score.reading import read_score
    from tonewood.performance.score.tablature import musicxml, tablature, text
    from tonewood.sound.render.renderer import assembled
    from tonewood.support.whole_files import whole_file

    if output is not None and output.suffix.lower() not in (".musicxml", ".xml", ".txt"):
        ending = output.suffix or "a name without an ending"
        raise OutputError(f"{ending} is not written; .musicxml or .txt are", file=output)
    if output is None and not as_json:
        raise TonewoodError("Missing option '--output' / '-o', or --json")
    length = _meter(meter)
    music = read_score(score, **common.reading(0.0, None, transpose, 1.0, tracks))
    bundle = common.load(instrument, settings, allow_code, strings)
    model = assembled(bundle, RenderOptions())
    lines = playable(model, capo)
    if not any(len(string.pitches) > 1 for string in lines):
        raise TonewoodError(f"{bundle.name} has no stops: tablature is for strings that fingers stop")
    if len(lines) > _MOST:
        raise TonewoodError(f"{bundle.name} has {len(lines)} strings: tablature has up to {_MOST}")
    with common.dropped_notes_listed():
        performance = perform(music, model, capo=capo)
    beats = music.beats or Beats()
    if length is not None:
        beats = Beats(beats.tempos, [(0.0, length)])
    title = music.metadata.get("title", music.name)
    fingering = tablature(performance.notes, lines, beats, title=title, capo=capo)
    if output is not None:
        with whole_file(output) as stream:
            stream.write(text(fingering).encode() if output.suffix.lower() == ".txt" else musicxml(fingering))
    dropped = performance.dropped
    if as_json:
        rows = [
            {
                "time_s": p.note.note.time, "duration_s": p.note.note.duration, "note": p.note.note.note,
                "string": p.note.string, "stop": p.note.stop, "fret": p.fret, "finger": p.finger, "hand": p.hand,
                "measure": sum(m <= tick for m in fingering.measures),
            }
            for tick, chord in fingering.chords
            for p in chord
        ]  # fmt: skip
        lost = [{"time_s": d.time, "note": d.note, "channel": d.channel, "reason": d.reason} for d in dropped]
        report = {"output": None if output is None else str(output), "capo": capo, "notes": rows, "notes_dropped": lost}
        common.print_json(
            "tab", report | {"warnings": list(performance.warnings), "ignored": dict(performance.ignored)}
        )
        return
    common.warn_of_kinds(performance.warnings)
    common.warn_of_dropped(dropped)
    n = sum(len(chord) for _, chord in fingering.chords)
    hands = [chord[0].hand for _, chord in fingering.chords]
    shifts = sum(a != b for a, b in pairwise(hands))
    print(
        f"{output}: {counted(n, 'note')} on {counted(len(lines), 'string')}, {len(dropped)} dropped, "
        f"{counted(len(fingering.measures) - 1, 'measure')}, positions {min(hands)} to {max(hands)}, "
        f"{counted(shifts, 'shift')}"
    )
    if performance.ignored:
        print(f"  without effect: {', '.join(f'{n} {kind}' for kind, n in performance.ignored.items())}")


def _meter(text: str | None) -> float | None:
    """Length of a measure in quarter notes."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,2})/(1|2|4|8|16|32)", text.strip())
    if match is None or not int(match[1]):
        raise TonewoodError(f"is {text!r}; N/M such as 3/4 or 6/8 is allowed", key="--meter")
    return 4.0 * int(match[1]) / int(match[2])
