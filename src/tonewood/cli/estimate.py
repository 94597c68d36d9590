"""``tonewood estimate``: an instrument from recordings of single notes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli.commands import InterruptError
from tonewood.cli.common import AllowCode, Json, allow, allow_file, load, need, print_json, progress, warn
from tonewood.cli.distance import NotesTable, Transpose, print_distances
from tonewood.support.whole_files import check_new_folder

if TYPE_CHECKING:
    from tonewood.workshop.estimate.estimate import Estimate


def estimate(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="sound files, one a note: A3.flac, 57.wav, E4_pp.wav")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="NAME", help="folder of the instrument that is made")
    ],
    source: Annotated[
        str, typer.Option("--from", metavar="INSTRUMENT", help="name or folder of the instrument to begin with")
    ],
    table: NotesTable = None,
    transpose: Transpose = 0,
    iterations: Annotated[int, typer.Option(help="of the search, 1 to 10")] = 3,
    page: Annotated[Path | None, typer.Option(help="write the report to this file, .html")] = None,
    title: Annotated[str | None, typer.Option(help="the instrument recorded, for the sources")] = None,
    recorded_by: Annotated[str | None, typer.Option(help="who recorded it, for the sources; unknown otherwise")] = None,
    licence: Annotated[str | None, typer.Option(help="SPDX name of the recordings' licence; unknown otherwise")] = None,
    url: Annotated[str | None, typer.Option(help="address of the recordings, for the sources")] = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Estimate an instrument from recordings of single notes: strings, place of the pluck, gain of each output.

    The same analysis is made of recorded and of rendered notes, and figures are moved until both agree. Every other
    note is held back once, to tell how far it is met. Writes a bundle NAME.
    """
    from tonewood.workshop.estimate.bundle import UNKNOWN, RecordingOrigin, write_bundle
    from tonewood.workshop.estimate.estimate import estimate as estimated
    from tonewood.workshop.estimate.recordings import read_folder

    _check(output, iterations, page)
    instrument = load(source, None, allow_code)
    recordings = read_folder(folder, table=table, transpose=transpose)
    try:
        with progress("estimating") as advance:
            result = estimated(recordings, instrument, iterations=iterations, advance=advance)
        origin = RecordingOrigin(title or UNKNOWN, recorded_by or UNKNOWN, licence or UNKNOWN, url)
        bundle = write_bundle(result, output, source, origin, allow_code=allow_code)
    except KeyboardInterrupt:
        raise InterruptError from None
    if page is not None:
        from tonewood.support.whole_files import write_whole
        from tonewood.workshop.estimate.page import page as report

        write_whole(page, report(result, origin, bundle.name))
    if as_json:
        from tonewood.workshop.estimate.as_json import to_json

        print_json("estimate", {"name": bundle.name, "folder": str(output), **to_json(result)})
        return
    warn(list(result.warnings))
    _print(result)
    print(f"{output}: plays at once; its body is that of {result.begun_with.name}{_but(result)}")


def _but(result: Estimate) -> str:
    """What of the body was moved."""
    count = len(result.figures.modes)
    return f", {count} mode{'s' if count > 1 else ''} moved" if count else ""


def _check(output: Path, iterations: int, page: Path | None) -> None:
    """Refuse before any work what could not be written."""
    check_new_folder(output)
    allow("--iterations", iterations, 1, 10, "")
    if page is not None:
        need("report", "jinja2", "matplotlib")
        allow_file("--page", page, ".html")


def _print(result: Estimate) -> None:
    """Figures with their intervals, and distances."""
    from tonewood.workshop.estimate import laws
    from tonewood.workshop.estimate.page import columns_of, louder_line, mode_lines, place_line, room_line, split_line

    for line in result.moved:
        print(line)
    stated = " ".join(f"{f / 1000:g}" for f in laws.STATED)
    print(f"string   notes   B re begun with   decay rate, 1/s, at {stated} kHz (90 %)")
    for name, law in result.figures.laws.items():
        interval = result.intervals.get(name)
        if interval is None and len(result.figures.laws) > 12:
            continue
        count = sum(p.string == name for p in result.notes)
        start = result.start.bending[name]
        b = result.figures.bending[name] / start if start > 0 else float("nan")
        rates = law.rate(laws.STATED)
        shown = "  ".join(
            f"{r:.2f}" if interval is None else f"{r:.2f} +-{100 * s:.0f} %"
            for r, s in zip(rates, laws.STATED * 0 if interval is None else interval.spread, strict=True)
        )
        remark = "" if result.figures.estimated.get(name) else "  (from the neighbouring strings)"
        print(f"{name:8s} {count:5d}   {b:15.3f}   {shown}{remark}")
    for line in (place_line(result), split_line(result), louder_line(result), *mode_lines(result), room_line(result)):
        if line:
            print(line)
    print_distances(columns_of(result))
