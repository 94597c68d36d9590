"""Stems of one instrument: a file per output group, or per string of each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain, count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tonewood.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from tonewood.sound.files.tags import Tags
    from tonewood.sound.live.take import Replay
    from tonewood.sound.render.renderer import Renderer


def check_stem_folder(folder: Path, *, parents: bool = False) -> None:
    """Check before any work that files can be written to the folder of ``--stems``: make it, and remove it again.

    Raises OutputError : it is a file, cannot be made, or cannot be written to.
    """
    from tonewood.support.whole_files import AtomicFile

    missing = []
    try:
        if folder.exists() and not folder.is_dir():
            raise OutputError("is a file; a folder is allowed", file=folder, key="--stems")
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        make_stem_folder(folder, parents=parents)
        AtomicFile(folder / "stem").discard()
    except OutputError as error:
        raise OutputError(error.reason, file=folder, key="--stems") from None
    except OSError as fault:  # a name too long, a folder that may not be searched
        raise OutputError(f"cannot be made: {fault.strerror}", file=folder, key="--stems") from None
    finally:
        for path in missing:
            with suppress(OSError):  # it was not made, or holds files of another program by now
                path.rmdir()


@contextmanager
def stem_folder(folder: Path, *, parents: bool = False) -> Iterator[None]:
    """Make the folder of ``--stems`` unless it is there; where an error leaves it empty it is removed again."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    make_stem_folder(folder, parents=parents)
    try:
        yield
    except BaseException:
        for path in missing:
            with suppress(OSError):  # some stems are written
                path.rmdir()
        raise


def make_stem_folder(folder: Path, *, parents: bool = False) -> None:
    """Make the folder of ``--stems`` unless it is there. Raises OutputError : it cannot be made."""
    try:
        folder.mkdir(parents=parents, exist_ok=True)
    except OSError as fault:
        raise OutputError(f"cannot be made: {fault.strerror}", file=folder, key="--stems") from None


def stem_files(folder: Path, names: Iterable[str], output: Path) -> list[Path]:
    """Files of stems, with the suffix of the mix; of equal names the second is numbered, ``name_2``.

    Names that differ by case alone are equal: they are one file on macOS and Windows.

    Raises OutputError : the mix has the name of one of them.
    """
    files: list[Path] = []
    taken = set[str]()
    for name in names:
        numbered = (f"{name}{end}" for end in chain([""], (f"_{i}" for i in count(2))))
        free = next(one for one in numbered if one.casefold() not in taken)
        taken.add(free.casefold())
        files.append(folder / f"{free}{output.suffix}")
    if output.resolve() in [file.resolve() for file in files]:
        raise OutputError("is the name of a stem; another is allowed", file=output, key="--stems")
    return files


def write_output_stems(
    output: Path, files: Sequence[Path], subtype: str, renderer: Renderer | Replay, tags: Tags
) -> None:
    """Cut the channels of a written file into one file per output group."""
    import soundfile as sf

    from tonewood.sound.files.audio import SoundWriter
    from tonewood.sound.render.routing import columns_of

    first = 0
    columns = columns_of(renderer.model.outputs, in_room=renderer.options.room is not None)
    for group, file in zip(columns, files, strict=True):
        n = len(group)
        with (
            sf.SoundFile(output) as source,
            SoundWriter(file, renderer.fs, n, subtype, frames=source.frames, tags=tags) as writer,
        ):
            for block in source.blocks(65536, dtype="float64", always_2d=True):
                writer.write(block[:, first : first + n])
        first += n


def write_string_stems(
    renderer: Renderer, files: Sequence[Path], subtype: str, gain_db: float, frames: int, tags: Tags
) -> dict[Path, int]:
    """Write a file per string and output group, ``GROUP.STRING``, as long as the mix and at its gain.

    Returns the number of samples beyond full scale of each file that has any: strings may cancel in the mix.

    renderer : of a model whose outputs are by string.
    files : a file per output group.
    gain_db, frames, tags : of the mix.
    """
    from contextlib import ExitStack

    from tonewood.sound.files.audio import SoundWriter

    groups = renderer.columns
    edges = np.cumsum([0, *map(len, groups)])
    written, factor = 0, 10 ** (gain_db / 20)
    with ExitStack() as stack:
        writers = [
            stack.enter_context(SoundWriter(file, renderer.fs, len(group), subtype, frames=frames, tags=tags))
            for file, group in zip(files, groups, strict=True)
        ]

        def write(block: np.ndarray) -> None:
            for writer, (first, last) in zip(writers, pairwise(edges), strict=True):
                writer.write(block[:, first:last] * factor)

        for block in renderer.blocks(4096):
            write(block[: frames - written])
            written += len(block[: frames - written])
            if written == frames:
                break
        while written < frames:  # the mix rang on longer
            write(np.zeros((min(65536, frames - written), int(edges[-1]))))
            written += min(65536, frames - written)
    return {file: writer.clipped for file, writer in zip(files, writers, strict=True) if writer.clipped}
