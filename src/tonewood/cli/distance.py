"""``tonewood distance``: how far one set of notes is from another, and the scatter within each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli.common import AllowCode, Json, load, print_json, progress, warn
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.workshop.estimate.distance import Distance

NotesTable = Annotated[
    Path | None, typer.Option(help="CSV: file, note, string, stop, dynamic, place (m); FOLDER/notes.csv if it is there")
]
Transpose = Annotated[int, typer.Option(help="semitones added to the notes of names and table")]


def distance(
    first: Annotated[Path, typer.Argument(metavar="A", help="folder of sound files, one a note, A3.flac")],
    second: Annotated[str, typer.Argument(metavar="B", help="another such folder, or an instrument")],
    table: NotesTable = None,
    transpose: Transpose = 0,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Tell how far notes are from those of one guitar: third octaves over time, onset, decays, levels.

    As the scale, distances within A and B stand beside it: between strokes of one note, and between next semitones.
    --table and --transpose are of A.
    """
    from tonewood.instrument.contract.registry import MANIFEST
    from tonewood.workshop.estimate.recordings import read_folder
    from tonewood.workshop.estimate.yardstick import compare_notes, played_as

    folder = read_folder(first, table=table, transpose=transpose)
    path = Path(second)
    if path.is_dir() and not (path / MANIFEST).is_file():
        other = read_folder(path)
    else:
        other = played_as(folder, load(second, None, allow_code))
    with progress("analysing") as advance:
        distances = compare_notes(folder, other, advance=advance)
    if not distances.between.notes:
        raise TonewoodError("nothing could be compared", file=first)
    columns = {"A to B": distances.between, **distances.scale}
    if as_json:
        rows = {name: row.as_dict() for name, row in columns.items()}
        report = {"a": str(first), "b": second, "notes": list(distances.shared), "distances": rows}
        print_json("distance", {**report, "warnings": list(distances.warnings)})
        return
    warn(list(distances.warnings))
    print_distances(columns)


def print_distances(columns: dict[str, Distance]) -> None:
    """A table of distances, a column each."""
    from tonewood.workshop.estimate.distance import Distance

    width = max(len(label) for label in Distance.LABELS.values())
    widths = [max(len(name.rstrip()), 7) for name in columns]
    print(" " * width + "  " + "  ".join(f"{n.rstrip():>{w}}" for n, w in zip(columns, widths, strict=True)))
    for key, label in Distance.LABELS.items():
        cells = [f"{getattr(d, key):.2f}".replace("nan", "-") for d in columns.values()]
        print(f"{label:{width}}  " + "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True)))
    print(f"{'notes':{width}}  " + "  ".join(f"{d.notes:>{w}}" for d, w in zip(columns.values(), widths, strict=True)))
