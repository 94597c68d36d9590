"""Chooses instruments for a score by its programs of General MIDI, from a table that users may replace."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from tonewood.errors import BundleError, TonewoodError
from tonewood.performance.score.note import ScorePart
from tonewood.sound.ensemble.mix import EnsemblePart
from tonewood.support.params import Parameters, described, validated
from tonewood.support.units import counted
from tonewood.support.yaml_io import load_yaml

_RANGE = re.compile(r"(\d{1,3})(?:-(\d{1,3}))?")
_TABLE = Path(__file__).with_name("programs.yaml")
#: program of a channel that names none
_FIRST = 1


class ProgramTable(Parameters):
    """A table of programs, as its YAML file has it."""

    programs: dict[str, str | None] = described(
        "program of General MIDI from 1 to 128, or a range such as 25-32: name of a bundle, or path to its folder; "
        "null leaves its notes out",
        min_length=1,
    )


def read_programs(path: str | os.PathLike[str] | None = None) -> dict[int, str]:
    """Read a table of programs; the one that comes with the package where no path is given.

    Returns Program from 1 to 128 -> instrument; programs that are left out are not in it.
    Raises BundleError : it cannot be read, or a value is not allowed; one line.
    """
    file = _TABLE if path is None else Path(path)
    table = validated(ProgramTable, load_yaml(file, error=BundleError), key="", file=file).programs
    by_program: dict[int, str] = {}
    seen: set[int] = set()
    for key, instrument in table.items():
        match = _RANGE.fullmatch(key)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= low <= high <= 128:
            reason = f"is no program; one from 1 to 128, or a range such as 25-32, is allowed, not {key!r}"
            raise BundleError(reason, file=file, key="programs")
        if again := sorted(seen & set(range(low, high + 1))):
            raise BundleError(f"program {again[0]} stands there twice", file=file, key=f"programs.{key}")
        seen |= set(range(low, high + 1))
        if instrument is not None:
            by_program |= dict.fromkeys(range(low, high + 1), instrument)
    return by_program


def choose_players(
    parts: Sequence[ScorePart], table: Mapping[int, str], file: str | os.PathLike[str] | None = None
) -> tuple[list[EnsemblePart], list[str]]:
    """Give each part the instrument of its program; one whose programs change is divided among theirs.

    parts : of a score.
    table : of `read_programs`.
    file : of the score, for errors.
    Returns players : parts and their instruments.
    notes : lines on parts that are left out, and on those that name no program.
    Raises TonewoodError : no part has an instrument.
    """
    players: list[EnsemblePart] = []
    lines: list[str] = []
    for part in parts:
        where = f"part {part.number}" + (f" ({part.name})" if part.name else "")
        if part.n_drums:
            lines.append(f"{where}: {counted(part.n_drums, 'note')} of percussion, left out")
        if part.programs.get(None):
            lines.append(f"{where} names no program: program {_FIRST}, as General MIDI has it")
        by_instrument: dict[str | None, Counter[int]] = {}
        for program, n in part.programs.items():
            number = program or _FIRST
            by_instrument.setdefault(table.get(number), Counter())[number] += n
        for instrument, programs in by_instrument.items():
            if instrument is None:
                named = ", ".join(map(str, sorted(programs)))
                n = sum(programs.values())
                lines.append(f"{where}: {counted(n, 'note')} left out, no instrument plays program {named}")
                continue
            players.append(EnsemblePart(part=part.number, instrument=instrument, programs=sorted(programs)))
    if not players:
        why = f": {lines[0]}" if lines else ""
        raise TonewoodError(f"no part has an instrument{why}; choose one by -i, --part or --programs", file=file)
    return players, lines
