"""Text tables that other programs export: numbers in columns, with a head or without, as frequency responses.

The longest run of lines with equally many numbers is the table; semicolons, tabs, commas or blanks separate, and a
decimal comma is read where another sign separates. The first column is the frequency. The head, where there is one,
says which columns are real and imaginary parts, or magnitude and phase, and of which quantity.
"""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.fit.arrays import ANGULAR, UNNAMED, Pair, ResponseTable, within_pi

#: name of a column of times, and of a force over time
_TIME, _FORCE = re.compile(r"\btime\b|\bsec|[\[(][mµμu]?s[\])]"), re.compile(r"force|hammer|[\[(][mk]?n[\])]")
#: units of columns over time that are not SI, and their factor; that of a voltage is the sensor's
_UNITS = {
    "mn": 1e-3, "kn": 1e3, "lbf": 4.4482216, "g": 9.80665, "gn": 9.80665, "mm/s^2": 1e-3, "mm/s²": 1e-3, "mm/s2": 1e-3,
    "mm/s": 1e-3, "µm/s": 1e-6, "um/s": 1e-6, "mm": 1e-3, "µm": 1e-6, "um": 1e-6, "v": np.nan, "mv": np.nan,
}  # fmt: skip
#: lines above a table that may name its columns
_ABOVE = 6
#: step and end of a first column without a name up to which it holds times
_TIME_STEP, _TIME_END = 1e-3, 20.0
#: bytes of a text, and fewest lines of a table
_LARGEST, _FEWEST = 64_000_000, 8
#: characters of a line that are shown
_SHOWN = 40
#: words of the head that say what a column holds
_KINDS = {
    "re": re.compile(r"real|r[eé]el|\bre\b|_re\b"), "im": re.compile(r"imag|\bim\b|_im\b"),
    "phase": re.compile(r"phase|fase|angle|\barg\b|\bdeg"),
    "mag": re.compile(r"magn|\bmag\b|ampl|ampiez|betrag|\babs|m[oó]dul|\|h|_mag\b"),
    "coherence": re.compile(r"coher"),
}  # fmt: skip
#: units of the head, without blanks beside their signs; a group is there where they are not SI, and its factor
_FORMS = (
    ("accelerance", re.compile(r"(?<![a-zµμ])(?:([mcunµμ]?)m/s(?:\^|\*\*)?[2²]|(g)n?)\)?[/(]n(?![a-z])")),
    ("mobility", re.compile(r"(?<![a-zµμ])([mcunµμ]?)m/s\)?/n(?![a-z])")),
    ("receptance", re.compile(r"(?<![a-zµμ])([mcunµμ]?)m/n(?![a-z])")),
)
_FACTORS = {"m": 1e-3, "c": 1e-2, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "g": 9.80665}
#: reference of a level: a number, or a power of ten
_REFERENCE = re.compile(r"\bre[fl]?\b[.:]?\s*(?:10\s*(?:\^|\*\*)\s*\(?(-?\d+)|(\d*\.?\d+(?:e[+-]?\d+)?))?")
#: a second column without a name is a phase in degrees if it is so many times larger than the first
_DEGREES = 20.0


def responses_of_text(path: Path) -> ResponseTable:
    """Read the table of a text file.

    Raises TonewoodError : there is no table of numbers, or its columns are no responses; the line says what is there.
    """
    head, columns, names, others = _table(path)
    named = [i for i, name in enumerate(names) if re.search("freq|hz", name)]
    at = named[0] if len(named) == 1 else 0
    freq, first, whole = columns[at], names[at] if names else "", " ".join(head).lower()
    if ANGULAR.fullmatch(first):
        raise TonewoodError(f"the column {first!r} may be in rad/s: divide it by 2 pi and call it Hz", file=path)
    if np.all(np.diff(freq) < 0):
        freq, columns = freq[::-1], columns[:, ::-1]
    if np.any(np.diff(freq[freq > 0]) <= 0):
        raise TonewoodError("frequencies do not rise; the first column has to hold them, or one called Hz", file=path)
    if re.search(r"khz", first):
        freq = 1e3 * freq
    rows, coherence, said = _rows(path, np.delete(columns, at, axis=0), [*names[:at], *names[at + 1 :]])
    flat = re.sub(r"\s*([/^*()])\s*", r"\1", whole)
    form, unit = next(((form, unit) for form, units in _FORMS if (unit := units.search(flat))), (None, None))
    remarks = [f"{path.name}: {line}" for line in said]
    if others:
        remarks.append(f"{path.name} holds more than one table: {others} lines of the shorter ones were not read")
    factor = next((_FACTORS[group] for group in unit.groups() if group), None) if unit else None
    if unit and factor:
        remarks.append(
            f"{path.name} says {unit[0].removesuffix('n')}N: --scale {factor:g} makes it SI units, unless you gave it"
        )
    return ResponseTable(freq, rows, coherence, form, tuple(remarks))


def record_of_text(path: Path) -> tuple[Floats, Floats, Floats, list[float]] | None:
    """Time, force and the other channels, (n,), (n,) and (P, n), of a table over time; None of any other table.

    The force is the column that the head calls so, otherwise the first after time. Last come the SI units per unit of
    force and channels as the head has them, NaN of volts.

    Raises TonewoodError : there is no table of numbers.
    """
    _, columns, names, _ = _table(path)
    time, name = columns[0], names[0] if names else ""
    short = time[-1] < _TIME_END and np.ptp(time) < _TIME_STEP * time.size and np.diff(time).min() >= 0
    if re.search("hz|freq|rad", name) or not (short or _TIME.search(name)):
        return None
    forces = [i for i, name in enumerate(names) if i and _FORCE.search(name)]
    at = forces[0] if len(forces) == 1 else 1
    time = time * (1e-3 if re.search(r"[\[(]ms[\])]", name) else 1e-6 if re.search(r"[\[(][µμu]s[\])]", name) else 1.0)
    units = [_unit(name) for name in (names or [""] * len(columns))]
    return time, columns[at], np.delete(columns, [0, at], axis=0), [units[at], *np.delete(units, [0, at])]


def _unit(name: str) -> float:
    """SI units per unit that a name ends with, in brackets or as its last word."""
    words = re.findall(r"[^\s\[\](),]+", name.replace("μ", "µ"))
    return _UNITS.get(words[-1], 1.0) if len(words) > 1 else 1.0


def is_documented(path: Path) -> bool:
    """Whether a CSV file has this program's columns: `freq_Hz`, `time_s`, or names with a colon; or no line."""
    with path.open(encoding="utf-8", errors="replace") as file:
        first = next((line for line in file if line.strip() and not line.lstrip().startswith("#")), "freq_Hz")
    return any(word in first for word in ("freq_Hz", "time_s")) or bool(re.search(r"\w:\w", first))


def _numbers(line: str) -> list[float] | None:
    """Numbers of a line, an empty cell as NaN and a complex number as two; None if one cell is none."""
    line = re.sub(r'"\s*,\s*"', ";", line.strip()).replace('"', "")
    if re.search(r"\d[ij]\b", line, re.I):
        line = re.sub(r"(?<=[\d.])\s*([+-])\s*(?=[\d.,]+(e[+-]?\d+)?[ij])", r"\1", re.sub("[()]", "", line), flags=re.I)
    if ";" in line or "\t" in line:
        cells = re.split(r"\s*;\s*" if ";" in line else r"\s+", line.replace(",", "."))
    elif re.search(r"\s", line) and re.fullmatch(r"[\s\d,.eE+-]+", line) and not re.search(r",\s|\d,[^,\s]*,", line):
        cells = line.replace(",", ".").split()
    else:
        cells = re.split(r"\s*,\s*|\s+", line)
    out: list[float] = []
    try:
        for cell in cells:
            if "_" in cell or not cell.isascii():  # float would read 1_5 and other digits
                return None
            if re.search(r"\d[ij]$", cell, re.I):
                value = complex(cell.lower().replace("i", "j"))
                out += [value.real, value.imag]
            else:
                out.append(float(cell) if cell else np.nan)
    except ValueError:
        return None
    return None if np.isnan(out[0]) else out


def _cells(line: str) -> list[str]:
    """Words of a line of the head, by the sign that separates."""
    sign = next((sign for sign in (";", "\t", ",") if sign in line), None)
    words = line.strip().split(sign) if sign else re.split(r"\s+", line.strip())
    return [word.strip(" '\"\r\n") for word in words]


def _table(path: Path) -> tuple[list[str], Floats, list[str], int]:
    """Head, columns of numbers, the words above each column (none without a head), and lines of other tables."""
    raw = path.read_bytes()
    if len(raw) > _LARGEST or b"\0" in raw:
        raise TonewoodError("is no text, or longer than 64 MB", file=path)
    try:
        lines = raw.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:  # units with a small 2, of programs for Windows
        lines = raw.decode("cp1252", "replace").splitlines()
    rows = [_numbers(line) for line in lines]
    runs = [(0, 0, 0)]
    for size, run in groupby(range(len(rows)), key=lambda i: len(rows[i] or ())):
        inside = list(run)
        if size > 1:
            runs.append((len(inside), inside[0], inside[-1] + 1))
    length, first, stop = max(runs)
    if length < _FEWEST:
        raise TonewoodError(
            "holds no table of numbers: a column of frequencies, and real and imaginary parts (or magnitude and phase) "
            "of each response are wanted", file=path,
        )  # fmt: skip
    columns = np.array(rows[first:stop], dtype=np.float64).T
    for at in (first - 1, stop):
        line = lines[at].strip() if 0 <= at < len(lines) else ""
        if line[:1].isdigit() and rows[at] is None and len(_cells(line)) == len(columns):
            raise TonewoodError(
                f"is {line[:_SHOWN]!r}, beside the table, and no row of numbers; numbers without a sign for thousands, "
                "and empty cells, are allowed", file=path, line=at + 1,
            )  # fmt: skip
    head, others = lines[:first], sum(count for count, _, _ in runs if count >= _FEWEST) - length
    while len(columns) > 1 and np.isnan(columns[-1]).all():  # a sign that separates at the end of each line
        columns = columns[:-1]
    above = [words for line in head[-_ABOVE:] if len(words := _cells(line)) == len(columns)]
    names = [" ".join(words).lower() for words in zip(*above, strict=True)]
    return head, columns, names, others


def _rows(path: Path, columns: Floats, names: list[str]) -> tuple[dict[Pair, Complexes], dict[Pair, Floats], list[str]]:
    """Responses, coherences, and remarks on what no head says."""
    plain = [_REFERENCE.sub("", name) if "db" in name else name for name in names]
    kinds = [next((kind for kind, word in _KINDS.items() if word.search(name)), "") for name in plain]
    stem = re.sub(r"\W", "_", path.stem)
    stem = stem if stem[:1].isalpha() else f"p_{stem}"
    of = {kind: [i for i, k in enumerate(kinds) if k == kind] for kind in _KINDS}
    said: list[str] = []
    if of["re"] and len(of["re"]) == len(of["im"]):
        values = [columns[i] + 1j * columns[j] for i, j in zip(of["re"], of["im"], strict=True)]
    elif of["mag"] and len(of["mag"]) == len(of["phase"]):
        values = [
            _polar(columns[i], columns[j], names[i], names[j], said)
            for i, j in zip(of["mag"], of["phase"], strict=True)
        ]
    elif len(columns) == 1 or (of["mag"] and not of["phase"]):
        raise TonewoodError(
            "holds magnitudes without phase, which do not show modes: export real and imaginary parts, or magnitude "
            "and phase", file=path,
        )  # fmt: skip
    elif len(columns) % 2 == 0 and not any(re.search(r"[^\W\d_]{3}", name) for name in names):
        degrees = all(_looks_polar(m, p) for m, p in _by_two(columns))
        values = [_polar(m, p, "", "deg", said) if degrees else m + 1j * p for m, p in _by_two(columns)]
        what = "magnitude and phase in degrees" if degrees else "real and imaginary parts"
        said.append(f"no columns are named: after the frequency they were taken for {what}")
    else:
        raise TonewoodError(
            f"its {len(columns)} columns after the first are not clear ({', '.join(names) or 'no names above them'}): "
            "name them real and imaginary, or magnitude and phase", file=path,
        )  # fmt: skip
    points = [stem] if len(values) == 1 else [f"{stem}_{i + 1}" for i in range(len(values))]
    pairs = [(point, UNNAMED) for point in points]
    coherence = dict(zip(pairs, columns[of["coherence"]], strict=False)) if len(of["coherence"]) == len(pairs) else {}
    return (
        dict(zip(pairs, (np.asarray(x, dtype=np.complex128) for x in values), strict=True)),
        coherence,
        list(dict.fromkeys(said)),
    )


def _by_two(columns: Floats) -> list[tuple[Floats, Floats]]:
    return list(zip(columns[::2], columns[1::2], strict=True))


def _looks_polar(size: Floats, phase: Floats) -> bool:
    """Whether the second of two columns turns as degrees do, beside a magnitude or a level."""
    most = np.nanmax(np.abs(phase))
    if np.nanmax(size) < 0:
        return bool(_DEGREES < most <= 361)
    return bool(np.nanmin(size) >= 0 and _DEGREES * np.nanmax(size) < most <= 361)


def _polar(size: Floats, phase: Floats, size_name: str, phase_name: str, said: list[str]) -> Complexes:
    level, turn = "db" in size_name, bool(re.search(r"\brad", phase_name))
    if not level and np.nanmin(size) < 0:
        level = True
        said.append("magnitudes below 0 were taken for dB")
    if not turn and "deg" not in phase_name and within_pi(phase):
        turn = True
        said.append("phases that stay within pi were taken for radians")
    if level:
        reference = _REFERENCE.search(size_name)
        power, number = reference.groups() if reference else (None, None)
        size = (10.0 ** int(power) if power else float(number or 1)) * 10 ** (size / 20)
    return np.asarray(size * np.exp(1j * (phase if turn else np.deg2rad(phase))), dtype=np.complex128)
