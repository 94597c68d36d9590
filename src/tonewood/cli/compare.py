"""``tonewood compare`` and ``tonewood report``: facts of instruments, and differences between them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    BundleName,
    Json,
    Overrides,
    StringSetName,
    allow,
    installed,
    load,
    need,
    print_json,
    progress,
    warn,
)
from tonewood.cli.options import render_options
from tonewood.errors import OutputError, TonewoodError
from tonewood.instrument.bundle.overrides import parse_assignment
from tonewood.support.units import cents

if TYPE_CHECKING:
    from tonewood.workshop.report.comparison import Candidate, Comparison

Notes = Annotated[
    str | None,
    typer.Option(metavar="NOTES", help="notes to play, E2,A3, or places STRING:STOP, A2:12; see below for the default"),
]
PagePath = Annotated[Path | None, typer.Option("-o", "--output", help="write the page to this file, .html")]
Duration = Annotated[float, typer.Option(help="of each note, s")]
NoteVelocity = Annotated[float, typer.Option(help="MIDI velocity of each note, 1 to 127")]
Rate = Annotated[int, typer.Option(help="sampling rate, Hz")]

#: lines of a kind that are printed; the page and the JSON have all
_SHOWN = 8


def compare(
    instruments: Annotated[
        list[str],
        typer.Argument(
            help="names of bundles, or paths to their folders", metavar="INSTRUMENT...", autocompletion=installed
        ),
    ],
    variant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=VALUE[;...]", help="compare also with the first instrument so changed; may be given again"
        ),
    ] = None,
    notes: Notes = None,
    output: PagePath = None,
    duration: Duration = 4.0,
    velocity: NoteVelocity = 80.0,
    fs: Rate = 48000,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Compare instruments, or one with its variants: modes, mobility, decays, wolf notes, sounds, parameters.

    The others are compared with the first. Each --variant is the first instrument with values changed,
    'strings.E2.tension=80', several at once with semicolons between; 'strings_from=SET' puts a string set on. --set and
    --strings change all of them.

    Without --notes the lowest and the highest open string and the worst wolf note of each are played.
    """
    from tonewood.workshop.report.comparison import Candidate

    changes = _changes(strings, settings)
    candidates = [Candidate(load(name, settings, allow_code, strings), changes) for name in instruments]
    for text in variant or ():
        made = tuple(part.strip() for part in text.split(";") if part.strip())
        base = candidates[0].instrument
        candidates.append(Candidate(base.replace(dict(map(parse_assignment, made))), (*changes, *made)))
    if len(candidates) < 2:
        raise TonewoodError("one instrument: another one, or --variant, is wanted (or `tonewood report`)")
    _run(candidates, notes, output, duration, velocity, fs, as_json)


def report(
    instrument: BundleName,
    notes: Notes = None,
    output: PagePath = None,
    duration: Duration = 4.0,
    velocity: NoteVelocity = 80.0,
    fs: Rate = 48000,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Report on INSTRUMENT: sources, modes, mobility, tuning, decays, wolf notes, tension, and its sound.

    Without --notes the open strings and the worst wolf note are played.
    """
    from tonewood.workshop.report.comparison import Candidate

    candidate = Candidate(load(instrument, settings, allow_code, strings), _changes(strings, settings))
    _run([candidate], notes, output, duration, velocity, fs, as_json)


def _changes(strings: str | None, settings: Sequence[str] | None) -> tuple[str, ...]:
    """Changes of all instruments, as PATH=VALUE."""
    return (*([] if strings is None else [f"strings_from={strings}"]), *(settings or ()))


def _run(
    candidates: Sequence[Candidate],
    notes: str | None,
    output: Path | None,
    duration: float,
    velocity: float,
    fs: int,
    as_json: bool,
) -> None:
    """Check the options, compute, write the page and print."""
    render_options({"fs": fs})
    allow("--duration", duration, 0.1, 60.0, "s")
    allow("--velocity", velocity, 1.0, 127.0, "")
    wanted = [note.strip() for note in notes.split(",") if note.strip()] if notes is not None else None
    if wanted == []:
        raise TonewoodError("is empty; notes such as E2,A3 are wanted", key="--notes")
    need("report", "pyloudnorm")
    if output is not None:
        need("report", "jinja2", "matplotlib")
        if output.suffix.lower() not in (".html", ".htm"):
            raise TonewoodError(f"is {output.name!r}; a name ending in .html is allowed", key="--output")
        if not output.parent.is_dir():
            raise OutputError(f"there is no folder {str(output.parent)!r}", file=output)
    from tonewood.workshop.report.comparison import compare as compared

    with progress("computing", 1.0) as advance:
        found = compared(
            candidates,
            notes=wanted,
            fs=fs,
            duration=duration,
            velocity_midi=velocity,
            tell=lambda share: advance(share),
        )
        if output is not None:
            from tonewood.support.whole_files import write_whole
            from tonewood.workshop.report.page import page

            write_whole(output, page(found))
    if as_json:
        from tonewood.workshop.report.as_json import to_json

        command = "compare" if len(candidates) > 1 else "report"
        print_json(command, {**to_json(found), "page": None if output is None else str(output)})
        return
    _print(found)
    if output is not None:
        print(f"page: {output}")


def _print(found: Comparison) -> None:
    """The largest differences, and the worst wolf notes."""
    from tonewood.workshop.report.comparison import alike

    first, *others = found.instruments
    for facts in found.instruments:
        print(facts.heading + ("" if facts.strings else ", a body without strings"))
        warn([f"{facts.label}: {line}" for line in facts.warnings])
        warn([f"{facts.label} does not play {note}: {reason}" for note, reason in facts.missing_tones.items()])
    for i, facts in enumerate(others, 1):
        changed = [match for match in found.modes if not alike(match)]
        pairs = [(a, b) for match in changed if (a := match.modes[0]) and (b := match.modes[i])]
        pairs.sort(key=lambda pair: -max(mode.residue * mode.t60 for mode in pair))
        print(f"body modes that differ, {first.label} to {facts.label}, the strongest first: {len(pairs) or 'none'}")
        for a, b in pairs[:_SHOWN]:
            print(
                f"  {a.freq:>9.2f} to {b.freq:>9.2f} Hz {cents(b.freq / a.freq):>+8.1f} cents, "
                f"Q {a.q:.1f} to {b.q:.1f}, mass {a.mass:.3g} to {b.mass:.3g} kg"
            )
    if any(facts.strings for facts in found.instruments):
        print("wolf notes, the worst first: severity, breadth (cents), depth")
    for wolves in found.wolves[:_SHOWN]:
        for facts, wolf in zip(found.instruments, wolves.wolves, strict=True):
            if wolf is not None:
                print(
                    f"  {facts.label} {wolf.string}, {wolf.low_freq:.1f} to {wolf.high_freq:.1f} Hz: "
                    f"{wolf.severity_cents:.1f}, {wolf.breadth_cents:.0f}, {wolf.depth:.2f}"
                )
    if others:
        print(f"parameters that differ: {len(found.parameters)}")
        for row in found.parameters[:_SHOWN]:
            values = " | ".join("none" if v is None else str(v)[:40] for v in row.values)
            print(f"  {row.key}: {values} {row.unit}".rstrip())
