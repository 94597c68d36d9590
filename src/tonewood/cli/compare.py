"""``tonewood compare`` and ``tonewood report``: facts of instruments, and differences between them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
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
    allow_file,
    installed,
    load,
    need,
    print_json,
    progress,
    warn,
)
from tonewood.cli.options import render_options
from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.overrides import parse_assignment
from tonewood.support.units import number_in

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

Every = Annotated[bool, typer.Option("--all", help="print all wolf notes and parameters, not the first of each")]

#: lines of a kind that are printed; --all, the page and the JSON have all
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
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="name of the first --variant, given again of the second, and so on"),
    ] = None,
    sweep: Annotated[
        str | None,
        typer.Option(
            metavar="PATH=LOW:HIGH:COUNT",
            help="compare also with the first instrument at so many values of a number, evenly spaced: "
            "body.thickness=2.2e-3:3e-3:5",
        ),
    ] = None,
    notes: Notes = None,
    output: PagePath = None,
    duration: Duration = 4.0,
    velocity: NoteVelocity = 80.0,
    fs: Rate = 48000,
    strings: StringSetName = None,
    settings: Overrides = None,
    every: Every = False,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Compare instruments, or one with its variants: first what changed and whether it is heard, then the rest.

    The others are compared with the first. Each --variant is the first instrument with values changed,
    'strings.E2.tension=80', several at once with semicolons between; 'strings_from=SET' puts a string set on. --set and
    --strings change all of them.

    Without --notes the lowest and the highest open string and the worst wolf note of each are played.
    """
    from tonewood.workshop.report.comparison import LABELS, Candidate

    changes = _changes(strings, settings)
    candidates = [Candidate(load(bundle, settings, allow_code, strings), changes) for bundle in instruments]
    base, names = candidates[0].instrument, list(name or ())
    if len(names) > len(variant or ()):
        raise TonewoodError(f"{len(names)} names for {len(variant or ())} variants; one each is allowed", key="--name")
    for text, called in zip_longest(variant or (), names, fillvalue=""):
        texts = tuple(part.strip() for part in text.split(";") if part.strip())
        paths = [part.partition("=")[0].strip() for part in texts]
        if not texts or len(set(paths)) < len(paths):
            raise TonewoodError(f"is {text!r}; PATH=VALUE[;...], each path once, is allowed", key="--variant")
        candidates.append(Candidate(base.replace(dict(map(parse_assignment, texts))), (*changes, *texts), called))
    path = ""
    if sweep is not None:
        path, values = _swept(sweep, len(LABELS) - len(candidates))
        short = path.rpartition(".")[2]
        for value in values:
            texts = (f"{path}={value:g}",)
            candidates.append(Candidate(base.replace({path: value}), (*changes, *texts), f"{short} {value:g}"))
    if len(candidates) < 2:
        raise TonewoodError("one instrument: another one, --variant or --sweep is wanted (or `tonewood report`)")
    _run(candidates, notes, output, duration, velocity, fs, as_json, every, path)


def _swept(text: str, most: int) -> tuple[str, list[float]]:
    """Key and values of a sweep. Raises TonewoodError : the text is none, or has more values than there is room for."""
    path, equals, rest = text.partition("=")
    words = rest.split(":")
    low, high, count = (number_in(word) for word in [*words, *["nan"] * 3][:3])
    if not (equals and path.strip() and len(words) == 3 and low < high and count == round(count)):
        raise TonewoodError(f"is {text!r}; PATH=LOW:HIGH:COUNT, LOW below HIGH, is allowed", key="--sweep")
    if not 2 <= count <= most:
        raise TonewoodError(f"has {count:g} values; 2 to {most} are allowed beside the others", key="--sweep")
    steps = round(count) - 1
    return path.strip(), [float(f"{low + (high - low) * k / steps:.6g}") for k in range(steps + 1)]


def report(
    instrument: BundleName,
    notes: Notes = None,
    output: PagePath = None,
    duration: Duration = 4.0,
    velocity: NoteVelocity = 80.0,
    fs: Rate = 48000,
    strings: StringSetName = None,
    settings: Overrides = None,
    every: Every = False,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Report on INSTRUMENT: sources, modes, mobility, tuning, decays, wolf notes, tension, and its sound.

    Without --notes the open strings and the worst wolf note are played.
    """
    from tonewood.workshop.report.comparison import Candidate

    candidate = Candidate(load(instrument, settings, allow_code, strings), _changes(strings, settings))
    _run([candidate], notes, output, duration, velocity, fs, as_json, every)


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
    every: bool,
    sweep: str = "",
) -> None:
    """Check the options, compute, write the page and print."""
    render_options({"fs": fs})
    allow("--duration", duration, 0.1, 60.0, "s")
    allow("--velocity", velocity, 1.0, 127.0, "")
    names = [note.strip() for note in notes.split(",") if note.strip()] if notes is not None else None
    if names == []:
        raise TonewoodError("is empty; notes such as E2,A3 are wanted", key="--notes")
    need("report", "pyloudnorm")
    if output is not None:
        need("report", "jinja2", "matplotlib")
        allow_file("--output", output, ".html")
    from tonewood.workshop.report.comparison import compare as compared

    with progress("computing") as advance:
        result = compared(
            candidates,
            notes=names,
            fs=fs,
            duration=duration,
            velocity_midi=velocity,
            sweep=sweep,
            tell=lambda share: advance(share),
        )
        if output is not None:
            from tonewood.support.whole_files import write_whole
            from tonewood.workshop.report.page import page

            write_whole(output, page(result))
    if as_json:
        from tonewood.workshop.report.as_json import to_json

        command = "compare" if len(candidates) > 1 else "report"
        print_json(command, {**to_json(result), "page": None if output is None else str(output)})
        return
    _print(result, every)
    if output is not None:
        print(f"page: {output}")


def _print(result: Comparison, every: bool) -> None:
    """First what changed, or of one instrument its figures; then wolf notes and parameters; all of both on request."""
    from tonewood.workshop.report.summary import key_figures, lines, value_words

    most = None if every else _SHOWN
    for facts in result.instruments:
        print(facts.heading + ("" if facts.strings else ", a body without strings"))
        warn([f"{facts.label}: {line}" for line in facts.warnings])
        warn([f"{facts.label} does not play {note}: {reason}" for note, reason in facts.missing_tones.items()])
    if result.sweep:
        _print_sweep(result)
    elif len(result.instruments) == 1:
        for name, (value, unit) in key_figures(result.instruments[0]).items():
            print(f"  {name}: {value_words(value, unit)}")
    for i, facts in enumerate(result.instruments[1:], 1):
        if not result.sweep or every:
            first, *rest = lines(result, i)
            print("\n".join([f"{result.instruments[0].short} to {facts.short}: {first}", *rest]))
    if any(facts.strings for facts in result.instruments):
        print("wolf notes, the worst first: severity, breadth (cents), depth")
    for wolves in result.wolves[:most]:
        for facts, wolf in zip(result.instruments, wolves.wolves, strict=True):
            if wolf is not None:
                print(
                    f"  {facts.label} {wolf.string}, {wolf.low_freq:.1f} to {wolf.high_freq:.1f} Hz: "
                    f"{wolf.severity_cents:.1f}, {wolf.breadth_cents:.0f}, {wolf.depth:.2f}"
                )
    if len(result.instruments) > 1:
        print(f"parameters that differ: {len(result.parameters)}")
        for row in result.parameters[:most]:
            values = " | ".join("none" if v is None else str(v)[:40] for v in row.values)
            print(f"  {row.key}: {values} {row.unit}".rstrip())
    hidden = max(len(result.wolves), len(result.parameters)) > _SHOWN or result.sweep
    if hidden and not every:
        print("(--all prints the rest)")


def _print_sweep(result: Comparison) -> None:
    """A row for each value, a column for each figure."""
    from tonewood.workshop.report.summary import key_figures, value_words

    rows = []
    for value, facts in result.swept():
        first = {} if facts.strings else {f"mode {k}": (m.freq, "Hz") for k, m in enumerate(facts.body_modes[:3], 1)}
        rows.append((value, facts.label, first | key_figures(facts)))
    names = list(dict.fromkeys(name for _, _, figures in rows for name in figures))
    heads = [result.sweep, *(name.partition(",")[0] for name in names)]
    cells = [[f"{v:g} ({label})", *(value_words(*f[n]) if n in f else "-" for n in names)] for v, label, f in rows]
    wide = [max(len(row[k]) for row in [heads, *cells]) for k in range(len(heads))]
    for row in [heads, *cells]:
        print("  " + "  ".join(text.rjust(w) for text, w in zip(row, wide, strict=True)))
