"""Options, progress bars and messages that several commands share."""

from __future__ import annotations

import json
import re
import sys
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from tonewood.errors import DroppedNotesWarning, OutputError, TonewoodError
from tonewood.support.plain_values import finite
from tonewood.support.units import as_float, counted

if TYPE_CHECKING:
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.performance.score.note import Dropped

ScorePath = Annotated[Path, typer.Argument(help="score: MIDI, MusicXML or Guitar Pro file", metavar="SCORE")]
Start = Annotated[float, typer.Option("--start", help="begin of the excerpt of SCORE, s at its own tempo")]
Stop = Annotated[float | None, typer.Option("--stop", help="end of the excerpt of SCORE, s at its own tempo")]
Transpose = Annotated[float, typer.Option("--transpose", help="semitones added to every note")]
Tempo = Annotated[float, typer.Option("--tempo", help="factor on the speed of SCORE")]
Tracks = Annotated[
    str | None, typer.Option("--tracks", metavar="NUMBERS", help="parts or MIDI channels to read, e.g. 1,3")
]


def reading(start: float, stop: float | None, transpose: float, tempo: float, tracks: str | None) -> dict[str, Any]:
    """Settings of `read_score` from options of a command line. Raises TonewoodError : the tracks are no numbers."""
    numbers = None if tracks is None else [word.strip() for word in tracks.split(",") if word.strip()]
    if numbers is not None and not (numbers and all(word.isdecimal() and len(word) <= 9 for word in numbers)):
        raise TonewoodError(f"is {tracks!r}; numbers from 1, with commas between them, are allowed", key="--tracks")
    chosen = None if numbers is None else [int(word) for word in numbers]
    return {"start": start, "stop": stop, "transpose": transpose, "tempo": tempo, "tracks": chosen}


def installed() -> list[str]:
    """Names of installed instruments, for shell completion."""
    from tonewood.instrument.contract.registry import list_instruments

    return list(list_instruments())


def string_set_names() -> list[str]:
    """Names of string sets, for shell completion."""
    from tonewood.instrument.bundle.string_sets import string_sets

    return list(string_sets())


InstrumentName = Annotated[
    str,
    typer.Option("-i", "--instrument", help="name of a bundle, or path to its folder", autocompletion=installed),
]
OneInstrument = Annotated[
    str | None,
    typer.Option("-i", "--instrument", help="name of a bundle, or path to its folder", autocompletion=installed),
]
BundleName = Annotated[
    str,
    typer.Argument(help="name of a bundle, or path to its folder", metavar="INSTRUMENT", autocompletion=installed),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="override a parameter, e.g. strings.E2.note=D2; repeatable"),
]
StringSetName = Annotated[
    str | None,
    typer.Option(
        "--strings",
        metavar="SET",
        help="put a named string set on; `tonewood list` has them",
        autocompletion=string_set_names,
    ),
]
AllowCode = Annotated[
    bool, typer.Option("--allow-code", help="run plugins that lie as Python files in the bundle's folder")
]
LevelOption = Annotated[
    str | None,
    typer.Option(
        "--level",
        metavar="calibrated|peak|LUFS",
        help="calibrated: the instrument's full scale; peak: -1 dBFS; LUFS: -23 LUFS, no peak above -1 dBFS; "
        "default: peak, or calibrated with --gain or --limiter",
    ),
]
Subtype = Annotated[
    str | None,
    typer.Option(help="PCM_16, PCM_24, PCM_32, FLOAT or DOUBLE; PCM_24, where left out"),
]
Json = Annotated[bool, typer.Option("--json", help="one JSON object on stdout, nothing else")]


def print_json(command: str, report: Mapping[str, Any], *, ok: bool = True) -> None:
    """Print the report of a command: one JSON object, with its schema, and whether the exit code is 0, first.

    Numbers that are not finite become null.
    """
    plain = {"schema": f"tonewood-{command}/1", "ok": ok, **report}
    print(json.dumps(finite(plain), allow_nan=False))


class Advance(Protocol):
    """Moves a progress bar to a position."""

    def __call__(self, position: float) -> None:
        """`position` on the bar's own scale."""


@contextmanager
def progress(label: str, total: float = 1.0) -> Iterator[Advance]:
    """Progress bar on a terminal, silence in a pipe; its last position is `total`."""
    if not sys.stderr.isatty():
        yield lambda position: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda position: bar.update(task, completed=min(position, total))


def load(name: str, overrides: list[str] | None, allow_code: bool, strings: str | None = None) -> Instrument:
    """Load an instrument, put a string set on and apply ``--set``."""
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.instrument.bundle.overrides import parse_assignment
    from tonewood.support.stages import listen, on_terminal

    listen(on_terminal())
    instrument = Instrument.load(name, allow_code=allow_code)
    changes = {} if strings is None else {"strings_from": strings}
    return instrument.replace(changes | dict(map(parse_assignment, overrides or [])))


def need(extra: str, *modules: str) -> None:
    """Check before any work that the modules of an extra are installed.

    Raises TonewoodError : names the first that is missing, and the extra that installs all of them.
    """
    from importlib.util import find_spec

    for name in modules:
        if find_spec(name) is None:
            raise TonewoodError(f"this needs {name}, which is not installed: pip install 'tonewood[{extra}]'")


def allow(option: str, value: float, low: float, high: float, unit: str) -> None:
    """Refuse an option's value outside its range, or not a number.

    Raises TonewoodError : names the option and the values allowed.
    """
    if not low <= value <= high:
        shown = f"{as_float(value):.12g} {unit}".strip()
        raise TonewoodError(f"is {shown}; {low:.12g} to {high:.12g} are allowed", key=option)


def allow_word(option: str, value: str, words: Iterable[str]) -> None:
    """Refuse an option's value that is none of some words. Raises TonewoodError : names the option and the words."""
    if value not in (allowed := list(words)):
        raise TonewoodError(f"is {value!r}; {', '.join(allowed)} are allowed", key=option)


def allow_band(band: tuple[float, float]) -> None:
    """Refuse a ``--band`` that does not rise, or begins below 0 Hz. Raises TonewoodError : says what is allowed."""
    if not 0 <= band[0] < band[1]:
        raise TonewoodError(f"is {band[0]:g} {band[1]:g}; a lower and a higher frequency are allowed", key="--band")


def allow_file(option: str, path: Path | None, *endings: str) -> None:
    """Refuse before any work a file to write of another ending, or in a folder that is not there; None is allowed.

    Raises TonewoodError : names the option and the endings.  OutputError : names the folder.
    """
    if path is None:
        return
    ending = path.suffix.lower()
    if {".htm": ".html", ".yml": ".yaml"}.get(ending, ending) not in endings:
        raise TonewoodError(f"is {path.name!r}; a name ending in {' or '.join(endings)} is allowed", key=option)
    if not path.absolute().parent.is_dir():
        raise OutputError(f"there is no folder {str(path.parent)!r}", file=path)


@contextmanager
def dropped_notes_listed() -> Iterator[None]:
    """Suppress the library's warning of dropped notes: the command lists them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)
        yield


def warn_of_dropped(dropped: Sequence[Dropped], where: str = "") -> None:
    """Print on stderr how many notes cannot be played, where the first is and why: one line a kind of reason.

    dropped : in time order.
    where : before each line.
    """
    kinds: dict[str, list[Dropped]] = {}
    for drop in dropped:
        kinds.setdefault(_kind(drop.reason), []).append(drop)
    for drops in kinds.values():
        first, more = drops[0], f", nor {counted(len(drops) - 1, 'other note')} for such a reason" if drops[1:] else ""
        warn([f"{where}not played at {first.time:.2f} s: {first.reason}{more}"])


def warn_of_kinds(lines: Sequence[str]) -> None:
    """Print warnings on stderr, one line a kind: of those that differ in numbers and names of notes, the first."""
    counts = Counter(map(_kind, lines))
    first = {_kind(line): line for line in reversed(lines)}
    warn([first[kind] + (f" (and {n - 1} more of this kind)" if n > 1 else "") for kind, n in counts.items()])


def _kind(line: str) -> str:
    """A line without its numbers and names of notes."""
    return re.sub(r"\b[A-G][#b]?-?\d+\b|-?\d+(\.\d+)?(e[-+]?\d+)?", "", line)


def warn(lines: list[str]) -> None:
    """Print warnings on stderr, one line each."""
    for line in lines:
        print(f"tonewood: warning: {line}", file=sys.stderr)


class _Failure(Protocol):
    """Something of many that failed."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def reason(self) -> str:
        """Why."""


def print_faults(faults: Iterable[_Failure], others: str) -> None:
    """Print each reason once, with the name of the first that failed and how many others did."""
    reasons: dict[str, list[str]] = {}
    for fault in faults:
        reasons.setdefault(fault.reason, []).append(fault.name)
    for reason, names in reasons.items():
        more = "" if len(names) == 1 else f" and {len(names) - 1} other {others}"
        print(f"tonewood: failed: {names[0]}{more}: {reason}", file=sys.stderr)
