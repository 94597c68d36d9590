"""``tonewood new``: make a bundle for an instrument of your own."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.commands import InterruptError
from tonewood.cli.common import AllowCode, Json, StringSetName, print_json


def new(
    folder: Annotated[Path, typer.Argument(metavar="NAME", help="of the instrument, and of the folder that is made")],
    source: Annotated[
        str, typer.Option("--from", metavar="SOURCE", help="name or folder of an instrument, or folder of a fit")
    ],
    strings: StringSetName = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Make a folder NAME with an instrument to be changed: it plays at once, and says where a person has to decide.

    Copied figures are of unknown origin until the maker says more.
    """
    from tonewood.instrument.bundle.new_bundle import new_bundle

    try:
        bundle = new_bundle(folder, source, strings=strings, allow_code=allow_code)
    except KeyboardInterrupt:
        raise InterruptError from None
    files = sorted(str(path.relative_to(bundle.folder)) for path in bundle.folder.rglob("*") if path.is_file())
    if as_json:
        unknown = bundle.origins.of_unknown_origin()
        print_json("new", {"name": bundle.name, "folder": str(bundle.folder), "files": files, "unknown": unknown})
        return
    print(f"{bundle.folder}: {', '.join(files)}")
    print(
        f"strings {', '.join(bundle.resonators)}; {len(bundle.origins.of_unknown_origin())} figures of unknown origin"
    )
    # ./NAME is a folder, also where an installed instrument has the name
    print(f"decide where instrument.yaml says DECIDE; then: tonewood check {os.path.join('.', bundle.folder)}")
