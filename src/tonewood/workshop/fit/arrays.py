"""Named arrays of .npz, .npy and .mat files, and columns of .csv files, as frequency responses.

Names that say all: ``freq_Hz`` and ``POINT:REFERENCE`` (complex), or its parts ``_re, _im`` or ``_mag, _phase``
(degrees), and ``POINT:REFERENCE_coherence``; MATLAB's names take ``__`` for the colon. Of other files the vector of
frequencies and the array of responses are recognised, or named (`chosen`): a response (N,), a column each (N, P), or
(N, P, R) with a column for each of R references. Of a single matrix the first column may be the frequencies.
"""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats

Pair = tuple[str, str]

#: reference of responses whose file does not say where the body was driven
UNNAMED = "unnamed"
_FREQUENCY = (re.compile("freq_Hz"), re.compile("freq.*", re.I), re.compile("f|hz|f_hz|xf", re.I))
_RESPONSE = re.compile(r"(h|hf|frf|tf|y|recep|mobil|accel|inert|transfer)", re.I)
_NO_RESPONSE = re.compile(r"(spec|psd|csd|corr|coh|cross|auto)", re.I)
#: names of a step of frequencies, of the first one and of their number; of angular frequencies; of times
_STEP, _FIRST = (
    re.compile("df|d_f|delta_?f|f_?step|increment", re.I),
    re.compile("f_?start|f_?min|f0|start_value", re.I),
)
_NUMBER, ANGULAR = re.compile("number_of_values|n_?f"), re.compile("w|om|omega.*|ang.*|.*rad.*", re.I)
_TIME, _RATE = re.compile("t|time.*", re.I), re.compile("dt|fs|.*sampl.*rate.*", re.I)
_FORM = {"recep": "receptance", "mobil": "mobility", "accel": "accelerance", "inert": "accelerance"}
#: bins that an array of responses has at least
_FEWEST = 8
#: characters of another library's message that are shown
_LONGEST = 64


@dataclass(frozen=True, eq=False)
class ResponseTable:
    """Responses of one file.

    freq : (N,) Hz.
    rows : (point, reference) -> (N,).
    coherence : of the same pairs, where it is there.
    form : receptance, mobility or accelerance where the file says so.
    remarks : on what was taken for what, a line each.
    """

    freq: Floats
    rows: Mapping[Pair, Complexes]
    coherence: Mapping[Pair, Floats]
    form: str | None = None
    remarks: tuple[str, ...] = ()


_BROKEN = (
    OSError, ValueError, EOFError, MemoryError, RuntimeError, AttributeError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def npz_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of an npz file, or the one of an npy file, called as the file. Raises TonewoodError : it is none."""
    try:
        content = np.load(path, allow_pickle=False)
        if isinstance(content, np.ndarray):
            return {path.stem: content}
        with content as archive:
            return {name: archive[name] for name in archive.files}
    # an archive that is damaged, encrypted, of a later version, or states an absurd shape raises any of these
    except _BROKEN as fault:
        raise TonewoodError(f"is no {path.suffix[1:]} file of arrays: {str(fault)[:_LONGEST]}", file=path) from None


def mat_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Numeric arrays of a MATLAB file of version 7 or earlier; fields of structs as STRUCT.FIELD.

    Raises TonewoodError : it is none, or of version 7.3.
    """
    from scipy.io import loadmat

    try:
        content = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise TonewoodError("is of MATLAB's version 7.3; save it with -v7", file=path) from None
    except Exception as fault:  # the reader raises exceptions of every kind on damaged files
        raise TonewoodError(f"is no MATLAB file: {str(fault).splitlines()[0][:_LONGEST]}", file=path) from None
    out: dict[str, NDArray[Any]] = {}

    def put(name: str, value: object) -> None:
        if hasattr(value, "_fieldnames"):
            for field in value._fieldnames:
                put(f"{name}.{field}" if name else field, getattr(value, field))
        elif (array := np.asarray(value)).dtype.kind in "iufc":
            out[name] = array

    for name, value in content.items():
        if not name.startswith("__"):
            put(name, value)
    return out


def responses_of_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], chosen: Sequence[str] = ()) -> ResponseTable:
    """Responses of named arrays.

    path : of the file, for messages.
    arrays : name -> array.
    chosen : names of the arrays that hold responses; those recognised where empty.
    Raises TonewoodError : no frequencies or responses are among them, or it is not clear which they are.
    """
    arrays, remarks = _frequencies_apart(arrays)
    key, freq = _frequencies(path, arrays)
    arrays, joined = _of_parts(arrays, freq.size)
    named: dict[str, NDArray[Any]] = {}
    for name, x in arrays.items():
        if name != key and _says_pair(name):
            colon = name.replace("__", ":", 1)
            if colon in named:
                raise TonewoodError(f"is in it as {name}, too; once is allowed", file=path, key=colon)
            named[colon] = x
    if named and not chosen:
        return _of_pairs(path, freq, named)
    by_name = {name: _by_bins(x, freq.size) for name, x in arrays.items() if name != key and freq.size in x.shape}
    likely = {name: x for name, x in by_name.items() if np.iscomplexobj(x)}
    for name in chosen:
        if name not in likely:
            shown = ", ".join(likely) or "none is there"
            raise TonewoodError(f"{name!r} is no complex array of {freq.size} bins; {shown}", file=path, key="--array")
    names = list(chosen) or [n for n in likely if _RESPONSE.match(_last(n)) and not _NO_RESPONSE.search(_last(n))]
    names = names or list(likely)
    if not names:
        real = [name for name, x in by_name.items() if _RESPONSE.match(_last(name))]
        if real:
            raise TonewoodError(
                f"{real[0]} is real: magnitudes without phase do not show modes; save complex responses", file=path
            )
        raise TonewoodError(
            f"holds no complex array of {freq.size} bins, as many as {key} has; there are {_shapes(arrays)}", file=path
        )
    if len(names) > 1 and not chosen:
        raise TonewoodError(
            f"which array holds responses is not clear: {', '.join(names)}; name it", file=path, key="--array"
        )
    rows = {pair: row for name in names for pair, row in _pairs_of(name, likely[name])}
    coherent = [x for name, x in by_name.items() if "coh" in name.lower() and not np.iscomplexobj(x)]
    alike = [x for x in coherent if len(names) == 1 and x.shape == likely[names[0]].shape]
    coherence = {pair: np.asarray(c.real, dtype=np.float64) for x in alike[:1] for pair, c in _pairs_of(names[0], x)}
    forms = {form for name in names for begin, form in _FORM.items() if begin in _last(name).lower()}
    remarks += [f"{n} of two columns was taken for real and imaginary parts" for n in names if n in joined]
    return ResponseTable(freq, rows, coherence, forms.pop() if len(forms) == 1 else None, tuple(remarks))


def _frequencies_apart(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Arrays, of a single matrix that begins with a column of frequencies that column for itself, and a remark."""
    large = [name for name, x in arrays.items() if x.size >= _FEWEST]
    if len(large) != 1 or arrays[large[0]].ndim != 2 or arrays[large[0]].shape[1] < 2:
        return dict(arrays), []
    name, x = large[0], arrays[large[0]]
    first, others = x[:, 0], x[:, 1:]
    real = x.dtype.kind in "iuf"
    if (real and others.shape[1] != 2) or np.any(first.imag) or first.real[0] < 0 or np.any(np.diff(first.real) <= 0):
        return dict(arrays), []
    others = others.squeeze().astype(np.float64 if real else np.complex128)
    remark = f"the first column of {name} was taken for frequencies in Hz; divide it by 2 pi if it is in rad/s"
    return {"freq_Hz": first.real, name: others}, [remark]


def _of_parts(arrays: Mapping[str, NDArray[Any]], n: int) -> tuple[dict[str, NDArray[Any]], set[str]]:
    """Arrays with those of n bins and two real columns made complex, if none is complex; and the names of these."""
    if any(np.iscomplexobj(x) and n in x.shape for x in arrays.values()):
        return dict(arrays), set()
    two = {name for name, x in arrays.items() if x.shape == (n, 2) and x.dtype.kind == "f"}
    return {name: x[:, 0] + 1j * x[:, 1] if name in two else x for name, x in arrays.items()}, two


def within_pi(phase: Floats) -> bool:
    """Whether phases that turn stay within pi, as radians do.

    phase : (N,) in an unknown unit.
    """
    finite = phase[np.isfinite(phase)]
    return bool(finite.size and np.abs(finite).max() <= 1.001 * np.pi and np.ptp(finite) > 1)


def pair_of(path: Path, name: str) -> Pair:
    """Return point and reference of POINT:REFERENCE. Raises TonewoodError : it is no such name."""
    point, colon, reference = name.partition(":")
    if not (point and colon and reference):
        raise TonewoodError("is no name of a response; POINT:REFERENCE is allowed", file=path, key=name)
    return point, reference


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _shapes(arrays: Mapping[str, NDArray[Any]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, x.shape)) or '1'}" for name, x in list(arrays.items())[:12])


def _says_pair(name: str) -> bool:
    return ":" in name or "__" in name.strip("_")


def _frequencies(path: Path, arrays: Mapping[str, NDArray[Any]]) -> tuple[str, Floats]:
    for pattern in _FREQUENCY:
        names = [name for name, x in arrays.items() if pattern.fullmatch(_last(name))]
        if pattern.pattern != "freq_Hz":  # a name that may mean something else
            real = {
                name for name, x in arrays.items()
                if x.dtype.kind in "iuf" and x.squeeze().ndim == 1 and x.size > 1 and np.all(np.diff(x.squeeze()) > 0)
            }  # fmt: skip
            names = [name for name in names if name in real]
        if len(names) > 1:
            raise TonewoodError(f"which are the frequencies: {', '.join(names)}? Call them freq_Hz", file=path)
        if names:
            x = arrays[names[0]]
            x = x.reshape(-1) if x.ndim == 2 and 1 in x.shape else x
            if x.dtype.kind not in "iuf" or x.ndim != 1:
                raise TonewoodError("is no row of real numbers", file=path, key=names[0])
            if not np.all(np.isfinite(x)):
                raise TonewoodError("holds a value that is not a finite number", file=path, key=names[0])
            if re.search("rad", names[0], re.I):
                raise TonewoodError("may be in rad/s: save freq_Hz, divided by 2 pi", file=path, key=names[0])
            return names[0], (1e3 if re.search("khz", names[0], re.I) else 1.0) * np.asarray(x, dtype=np.float64)
    if steps := _steps(arrays):
        return steps
    hint = ""
    rising = {_last(name) for name, x in arrays.items() if x.ndim == 1 and x.size > 1 and np.all(np.diff(x.real) > 0)}
    if names := sorted(name for name in rising if ANGULAR.fullmatch(name)):
        hint = f"; {names[0]} may be in rad/s: save freq_Hz = {names[0]} / (2 pi)"
    elif any(_TIME.fullmatch(name) for name in rising) or any(_RATE.fullmatch(_last(name)) for name in arrays):
        hint = "; records over time are read as text, one hit a file: columns of time, force, and one for each point"
    raise TonewoodError(f"has no array freq_Hz; there are {_shapes(arrays)}{hint}", file=path)


def _steps(arrays: Mapping[str, NDArray[Any]]) -> tuple[str, Floats] | None:
    """Frequencies of a first one, their step and, if it is not the number of rows of an array, their number."""
    single = {_last(name): (name, float(x)) for name, x in arrays.items() if x.ndim == 0 and not np.iscomplexobj(x)}
    step = next((single[name] for name in single if _STEP.fullmatch(name)), None)
    if step is None or not step[1] > 0:
        return None
    first = next((value for name, (_, value) in single.items() if _FIRST.fullmatch(name)), 0.0)
    sizes = [max(x.shape) for x in arrays.values() if x.ndim and max(x.shape) >= _FEWEST]
    number = next((int(value) for name, (_, value) in single.items() if _NUMBER.fullmatch(name)), None)
    if number is None and len(set(sizes)) == 1:
        number = sizes[0]
    return None if number is None else (step[0], first + step[1] * np.arange(number, dtype=np.float64))


def _by_bins(x: NDArray[Any], n_bins: int) -> NDArray[Any]:
    """Array with the bins first, at most three axes: bins, points, references."""
    x = np.moveaxis(x, x.shape.index(n_bins), 0)
    return x.reshape(*x.shape[:2], -1).squeeze() if x.ndim > 3 else x


def _pairs_of(name: str, x: NDArray[Any]) -> list[tuple[Pair, Complexes]]:
    stem = re.sub(r"\W", "_", _last(name))
    x = np.asarray(x, dtype=np.complex128)
    if x.ndim == 1:
        return [((stem, UNNAMED), x)]
    if x.ndim == 2:
        return [((f"{stem}_{p + 1}", UNNAMED), x[:, p]) for p in range(x.shape[1])]
    square = x.shape[1] == x.shape[2]  # point p is where reference p was driven
    return [
        ((f"{stem}_{p + 1}", f"{stem}_{r + 1}" if square else f"{UNNAMED}_{r + 1}"), x[:, p, r])
        for p in range(x.shape[1])
        for r in range(x.shape[2])
    ]


def _of_pairs(path: Path, freq: Floats, arrays: Mapping[str, NDArray[Any]]) -> ResponseTable:
    """Arrays named POINT:REFERENCE, whole or in parts."""
    for name, values in arrays.items():
        real = name.endswith(("_re", "_im", "_mag", "_phase", "_coherence"))
        if values.ndim != 1 or values.dtype.kind not in ("iuf" if real else "iufc"):
            raise TonewoodError(f"is no row of {'real' if real else 'complex'} numbers", file=path, key=name)
        if values.shape != freq.shape:
            raise TonewoodError(f"has the shape {values.shape}; {freq.shape} is allowed", file=path, key=name)
    rows: dict[Pair, Complexes] = {}

    def put(name: str, values: NDArray[Any]) -> None:
        if pair_of(path, name) in rows:
            raise TonewoodError(
                "is in it in two forms; one of complex numbers, _re with _im, and _mag with _phase is allowed",
                file=path, key=name,
            )  # fmt: skip
        rows[pair_of(path, name)] = np.asarray(values, dtype=np.complex128)

    for name, values in arrays.items():
        stem, _, part = name.rpartition("_")
        if part == "coherence":
            continue
        other = {"re": "im", "im": "re", "mag": "phase", "phase": "mag"}.get(part)
        if other is None:
            put(name, values)
            continue
        if f"{stem}_{other}" not in arrays:
            raise TonewoodError(f"has no column {stem}_{other} beside {name}", file=path)
        second = arrays[f"{stem}_{other}"]
        if part == "mag" and values.min(initial=0) < 0:
            raise TonewoodError("holds a value below 0: dB? 10 ** (dB / 20) is a magnitude", file=path, key=name)
        if part == "mag" and within_pi(second):
            raise TonewoodError(f"stays within pi: radians? {stem}_phase is in degrees", file=path, key=f"{stem}_phase")
        if part in ("re", "mag"):
            turned = values + 1j * second if part == "re" else values * np.exp(1j * np.deg2rad(second))
            put(stem, turned)
    coherence = {
        pair: np.asarray(arrays[key], dtype=np.float64)
        for pair in rows
        if (key := f"{pair[0]}:{pair[1]}_coherence") in arrays
    }
    return ResponseTable(freq, rows, coherence)
