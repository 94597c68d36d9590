"""``tonewood migrate``: bundles and batch manifests of earlier versions, rewritten for this one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import Json, print_json
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.support.yaml_edit import Edit


def migrate(
    paths: Annotated[
        list[Path], typer.Argument(help="folder of a bundle, its instrument.yaml, or a batch manifest", metavar="PATH")
    ],
    check: Annotated[bool, typer.Option("--check", help="report only, write nothing")] = False,
    as_json: Json = False,
) -> int:
    """Rewrite bundles and batch manifests of earlier versions in place.

    Comments, order and number formats stay. Each file is replaced in one step; one that is up to date is not touched.
    Nothing is written if one of the PATHs cannot be read. Exit code 1 if --check found something to rewrite.
    """
    from tonewood.support.whole_files import write_whole
    from tonewood.support.yaml_edit import edit_text

    outdated = []
    for path in paths:
        file = path / "instrument.yaml" if path.is_dir() else path
        edits, text = _edits(file)
        outdated.append((file, edits, edit_text(text, edits, file=file) if edits else text))
    for file, edits, text in outdated:
        if edits and not check:
            write_whole(file, text)
    ok = not (check and any(edits for _, edits, _ in outdated))
    if as_json:
        files = [{"file": str(file), "edits": [e.reason for e in edits]} for file, edits, _ in outdated]
        print_json("migrate", {"written": not check, "files": files}, ok=ok)
        return 0 if ok else 1
    done = "would be rewritten" if check else "rewritten"
    for file, edits, _ in outdated:
        print(f"{file}: {done}: {'; '.join(e.reason for e in edits)}" if edits else f"{file}: up to date")
    return 0 if ok else 1


def _edits(file: Path) -> tuple[list[Edit], str]:
    """Return the edits that a file needs, by the kind of its schema, and its present text."""
    from tonewood.instrument.bundle.migration import bundle_edits
    from tonewood.support.yaml_io import load_yaml
    from tonewood.workshop.batch.migration import manifest_edits

    values: dict[str, Any] = load_yaml(file)
    kind = str(values.get("schema")).partition("/")[0]
    if kind == "tonewood-instrument":
        edits = bundle_edits(values, file)
    elif kind == "tonewood-batch":
        edits = manifest_edits(values, file)
    else:
        reason = "neither a bundle (tonewood-instrument/N) nor a batch manifest (tonewood-batch/N)"
        raise TonewoodError(reason, file=file, key="schema")
    return edits, file.read_bytes().decode()
