"""Exports of a batch's folder, by the name of the program they are for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tonewood.errors import OutputError, TonewoodError
from tonewood.support.whole_files import folder_whole
from tonewood.workshop.exchange import bids, jspsych, psychopy, webmushra
from tonewood.workshop.exchange.course import FOLDER, Exported
from tonewood.workshop.listening.definition import ListeningTest, load_test

PROGRAMS: dict[str, Callable[[ListeningTest, Path], Exported]] = {
    "webmushra": webmushra.write,
    "jspsych": jspsych.write,
    "psychopy": psychopy.write,
    "bids": bids.write,
}


def check_programs(programs: Sequence[str]) -> None:
    """Check names of programs. Raises TonewoodError : one is not known."""
    for name in programs:
        if name not in PROGRAMS:
            raise TonewoodError(f"is {name!r}; {', '.join(PROGRAMS)} are allowed", key="--export")


def export(folder: Path, programs: Sequence[str]) -> list[Exported]:
    """Write ``export/PROGRAM`` in a batch's folder for each program; an earlier export is removed, and a part of one.

    Raises TonewoodError : a program is not known, the folder has no test, or a file cannot be removed or written.
    """
    import shutil

    check_programs(programs)
    test = load_test(folder)
    files = []
    for name in dict.fromkeys(programs):
        target = folder / FOLDER / name
        try:
            shutil.rmtree(target)
        except FileNotFoundError:
            pass
        except OSError as fault:  # what is left of it would count as part of the new one
            raise OutputError(f"cannot be removed: {fault.strerror or fault}", file=target) from None
        with folder_whole(target):
            files.append(PROGRAMS[name](test, target))
    return files
