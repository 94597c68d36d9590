"""Files of measured responses: frequency responses as CSV, npz, MATLAB or UFF58, and hammer hits as WAV or CSV.

===============  =====================================================================================================
CSV responses    ``freq_Hz`` and for each pair ``POINT:REFERENCE_re, _im`` or ``_mag, _phase`` (degrees); optionally
                 ``POINT:REFERENCE_coherence``
npz, npy, mat    the same names, or ``POINT:REFERENCE`` (complex), or arrays of any name: see `arrays`
UFF58            data sets 58 with func_type 4 (responses) and 6 (coherence), and 164 (units); points are named node and
                 direction, as ``12+3``; a direction with a minus turns the sign of its data
other texts      columns of numbers, the first the frequency: see `texts`
CSV hits         ``time_s, REFERENCE_force`` (N) and a column per point (m/s^2, m/s or m); a file a hit
other hits       texts whose first column is time: the force, then the points in order; a file a hit
WAV hits         channel 1 the force, the others the points in order; a file a hit, scaled by `sensitivity`
===============  =====================================================================================================

A name ending in ``_Pa`` in place of a point is a microphone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.instrument.contract.files import Files
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.sound_rates import read_samples
from tonewood.workshop.fit.arrays import (
    UNNAMED,
    Pair,
    ResponseTable,
    mat_arrays,
    npz_arrays,
    pair_of,
    responses_of_arrays,
)
from tonewood.workshop.fit.hits import responses_of_hits
from tonewood.workshop.fit.responses import FORMS, Responses, to_mobility
from tonewood.workshop.fit.texts import is_documented, record_of_text, responses_of_text
from tonewood.workshop.fit.universal import MICROPHONE, responses_of_uff

#: characters of another library's message that are shown
_LONGEST = 64
#: share of a record by which rounded times may leave a straight line
_ROUNDED = 2e-3


@dataclass(frozen=True)
class Reading:
    """How files are to be read.

    Attributes
    ----------
    form : receptance, mobility or accelerance; None where the file says so.
    n_hits : hits that were averaged, for the noise from a coherence.
    window_tau : s, of an exponential window: taken for hits, already in the data for responses.
    points : names of the responses of WAV channels 2 onwards, and of the columns after time and force.
    references : (point that was driven, beginning of the names of its files of hits, or the reference that it is).
    sensitivity : N at full scale of channel 1, then m, m/s, m/s^2 or Pa at full scale of each other channel; of texts
        these per unit, 1 where empty.
    estimator : H1 or H2, of hits.
    arrays : names of the arrays that hold responses, of npz and MATLAB files.
    scale : SI units per unit of the data, of responses that are no pressures: 9.80665 where they are in g/N.
    """

    form: str | None = None
    n_hits: int | None = None
    window_tau: float | None = None
    points: tuple[str, ...] = ()
    references: tuple[tuple[str, str], ...] = ()
    sensitivity: tuple[float, ...] = ()
    estimator: str = "H1"
    scale: float = 1.0
    arrays: tuple[str, ...] = ()


def read_responses(paths: Sequence[Path], reading: Reading) -> Responses:
    """Read files that belong together: responses of one body, or hits on it.

    Parameters
    ----------
    paths : of the files; frequency responses of one measurement, or recordings of hits.
    reading : options of the command line: references, sensitivities, windows.

    Returns
    -------
    Responses of all points at common frequencies, with their noise where it is known.

    Raises
    ------
    TonewoodError : a file cannot be read, contradicts another or says less than is needed; the line names it.
    """
    if not paths:
        raise TonewoodError("no file was given", key="FILES")
    hashes = _hashes(paths)
    kinds = {_kind(path) for path in paths}
    if len(kinds) > 1:
        raise TonewoodError(
            f"files of different kinds ({', '.join(sorted(kinds))}) do not make one measurement", key="FILES"
        )
    kind = kinds.pop()
    if kind == "hits":
        return _of_hits(paths, reading, hashes)
    tables = _driven(paths, [_table(kind, path, reading) for path in paths], reading)
    freq = tables[0].freq
    if not freq.size:
        raise TonewoodError("holds no bins", file=paths[0], key="freq_Hz")
    for path, table in zip(paths, tables, strict=True):
        if len(table.freq) != len(freq) or not np.allclose(table.freq, freq, rtol=1e-9, atol=0):
            raise TonewoodError("has other frequencies than the first file", file=path, key="freq_Hz")
    if np.any(np.diff(freq[freq > 0]) <= 0):
        raise TonewoodError("frequencies do not rise from bin to bin", file=paths[0], key="freq_Hz")
    rows: dict[Pair, Complexes] = {}
    for path, table in zip(paths, tables, strict=True):
        for pair, row in table.rows.items():
            if pair in rows:
                raise TonewoodError("is in another file, too; once is allowed", file=path, key=":".join(pair))
            rows[pair] = row
    if mirrored := _mirrored([row[freq >= 0] for row in rows.values()]):
        raise TonewoodError(
            f"its responses are two-sided: from bin {mirrored + 1} on they are the conjugate of those before, "
            "backwards; keep the first half", file=paths[0], key="freq_Hz",
        )  # fmt: skip
    for pair, row in rows.items():
        if np.any(row[np.isfinite(row)]) and not np.any(row.imag[np.isfinite(row)]):
            raise TonewoodError(
                f"the response {':'.join(pair)} is real: magnitudes without phase do not show modes; export real and "
                "imaginary parts, or magnitude and phase", file=paths[0],
            )  # fmt: skip
    coherence = {pair: row for table in tables for pair, row in table.coherence.items()}
    said = {table.form for table in tables if table.form is not None}
    for other in said:
        if reading.form is not None and other != reading.form:
            raise TonewoodError(f"says {other} while --form says {reading.form}", file=paths[0], key="--form")
    form = reading.form or (said.pop() if len(said) == 1 else "")
    if not form:
        raise TonewoodError(f"the quantity measured is not stated; {', '.join(FORMS)} are allowed", key="--form")
    alpha = 0.0 if reading.window_tau is None else 1.0 / reading.window_tau
    motion, pressure = _split(rows)
    pairs = tuple(motion)
    if not pairs:
        raise TonewoodError("no response of a point is in it", file=paths[0])
    mobility = to_mobility(
        reading.scale * np.array([motion[pair] for pair in pairs], dtype=np.complex128), freq, form, alpha
    )
    complete = all(pair in coherence for pair in pairs)
    remarks = tuple(line for table in tables for line in table.remarks)
    if negative := int(np.count_nonzero(freq < 0)):
        remarks += (f"{negative} bins of frequencies below 0 were left out",)
    return Responses(
        freq, mobility, pairs, np.array([coherence[pair] for pair in pairs]) if complete else None, reading.n_hits,
        alpha, pressure, hashes, remarks=remarks,
    )  # fmt: skip


def _mirrored(rows: Sequence[Complexes]) -> int:
    """Bin from which responses repeat those before it, backwards and conjugate, as those of a whole FFT; 0: none."""
    for first in (0, 1):  # without and with 0 Hz
        halves = [row[first:] for row in rows]
        if all(
            half.size
            and np.any(half.imag)
            and np.allclose(half, half[::-1].conj(), atol=1e-6 * np.nanmax(np.abs(half)))
            for half in halves
        ):
            return (halves[0].size + 1) // 2 + first
    return 0


def _table(kind: str, path: Path, reading: Reading) -> ResponseTable:
    if kind == "uff":
        return responses_of_uff(path)
    if kind == "text":
        return responses_of_text(path)
    if kind == "csv":
        return _csv(path)
    return responses_of_arrays(path, npz_arrays(path) if kind == "npz" else mat_arrays(path), reading.arrays)


def _driven(paths: Sequence[Path], tables: Sequence[ResponseTable], reading: Reading) -> list[ResponseTable]:
    """Tables with the names of references that the command line gives."""
    names: dict[str, str] = {}
    for name, reference in reading.references:
        references = dict.fromkeys(reference for table in tables for _, reference in table.rows)
        old = reference or UNNAMED
        if old not in references:
            raise TonewoodError(
                "frequency responses name their references themselves" if not reference
                else f"there is no reference {reference!r}; there are {', '.join(references)}",
                file=paths[0], key="--driving",
            )  # fmt: skip
        points = dict.fromkeys(point for table in tables for point, _ in table.rows)
        if name not in points:
            shown = ", ".join(points)
            raise TonewoodError(f"there is no point {name!r}; there are {shown}", file=paths[0], key="--driving")
        names[old] = name

    def renamed(rows: Mapping[Pair, Any]) -> dict[Pair, Any]:
        return {(point, names.get(old, old)): row for (point, old), row in rows.items()}

    return [replace(table, rows=renamed(table.rows), coherence=renamed(table.coherence)) for table in tables]


def _hashes(paths: Sequence[Path]) -> dict[str, str]:
    """Name -> SHA-256 of each file; files of one name by their paths."""
    names = [path.name for path in paths]
    hashes: dict[str, str] = {}
    for path in paths:
        digest = _hash(path)
        if same := next((name for name, other in hashes.items() if other == digest), None):
            raise TonewoodError(f"has the same content as {same}; each file once is allowed", file=path)
        hashes[path.name if names.count(path.name) == 1 else str(path)] = digest
    return hashes


def _hash(path: Path) -> str:
    if path.is_char_device() or path.is_fifo():
        raise TonewoodError("is a device, whose content may not end", file=path)
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as fault:
        raise TonewoodError(f"cannot be read: {fault.strerror}", file=path) from None


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix == ".wav":
        return "hits"
    if suffix in (".txt", ".tsv", ".dat", ".asc") or (suffix == ".csv" and not is_documented(path)):
        return "text" if record_of_text(path) is None else "hits"
    if suffix == ".csv":
        return "hits" if "time_s" in _numbers(path) else "csv"
    if suffix in (".npz", ".npy", ".mat"):
        return "mat" if suffix == ".mat" else "npz"
    if suffix in (".uff", ".unv", ".u58", ".58"):
        return "uff"
    raise TonewoodError(
        "is of no kind that is read; .csv, .txt, .npz, .npy, .mat, .uff, .unv and .wav are allowed (export frequency, "
        "real and imaginary parts as text)", file=path,
    )  # fmt: skip


def _split(rows: Mapping[Pair, Complexes]) -> tuple[dict[Pair, Complexes], dict[Pair, Complexes]]:
    """Responses of points, and of microphones."""
    motion = {pair: row for pair, row in rows.items() if not pair[0].endswith(MICROPHONE)}
    pressure = {(p.removesuffix(MICROPHONE), r): row for (p, r), row in rows.items() if p.endswith(MICROPHONE)}
    return motion, pressure


def _numbers(path: Path) -> dict[str, Floats]:
    """Columns of a CSV file."""
    return Files(path.parent, path).table(path.name)


def _csv(path: Path) -> ResponseTable:
    columns = _numbers(path)
    if "freq_Hz" not in columns:
        raise TonewoodError(f"has no column freq_Hz; there are {', '.join(columns)}", file=path)
    parts = ("_re", "_im", "_mag", "_phase")
    for name in columns:
        if name.endswith(parts):
            pair_of(path, name)
    return responses_of_arrays(path, {name: x for name, x in columns.items() if name == "freq_Hz" or ":" in name})


def _of_hits(paths: Sequence[Path], reading: Reading, hashes: Mapping[str, str]) -> Responses:
    if reading.form is None:
        raise TonewoodError(f"the quantity measured is not stated; {', '.join(FORMS)} are allowed", key="--form")
    struck: dict[str, list[tuple[Path, _Hit]]] = {}
    for path in paths:
        hit = _hit(path, reading)
        struck.setdefault(hit.reference, []).append((path, hit))
    first = next(iter(struck.values()))[0][1]
    for path, hit in (entry for group in struck.values() for entry in group):
        if (hit.fs, hit.names, hit.force.size) != (first.fs, first.names, first.force.size):
            raise TonewoodError("has another rate, length or other channels than the first file", file=path)
        if not (np.isfinite(hit.force).all() and np.isfinite(hit.motion).all()):
            raise TonewoodError("holds a sample that is not a finite number", file=path)
        if any(_padded(row) for row in hit.motion):
            raise TonewoodError(
                "ends in zeros: of a padded hit neighbouring bins say the same; cut them off", file=path
            )
    parts = [_of_one_reference(name, [hit for _, hit in group], reading) for name, group in struck.items()]
    whole = parts[0]
    for part in parts[1:]:
        assert whole.kept is not None
        assert part.kept is not None
        whole = replace(
            whole, mobility=np.vstack([whole.mobility, part.mobility]), pairs=whole.pairs + part.pairs,
            coherence=None if whole.coherence is None or part.coherence is None
            else np.vstack([whole.coherence, part.coherence]), n_hits=min(whole.n_hits or 1, part.n_hits or 1),
            pressure={**whole.pressure, **part.pressure},
            kept=(whole.kept[0] + part.kept[0], whole.kept[1] + part.kept[1]), remarks=whole.remarks + part.remarks,
        )  # fmt: skip
    return replace(whole, files=hashes)


def _of_one_reference(reference: str, hits: Sequence[_Hit], reading: Reading) -> Responses:
    """Responses to the hits on one point."""
    assert reading.form is not None
    try:
        responses = responses_of_hits(
            np.array([hit.force for hit in hits]), np.array([hit.motion for hit in hits]), hits[0].fs,
            window_tau=reading.window_tau, estimator=reading.estimator,
        )  # fmt: skip
    except ValueError as fault:
        raise TonewoodError(f"at {reference}: {fault}", key="FILES") from None
    rows = {(name, reference): row for name, row in zip(hits[0].names, responses.response, strict=True)}
    coherence = dict(zip(rows, responses.coherence, strict=True))
    motion, pressure = _split(rows)
    pairs = tuple(motion)
    if not pairs:
        raise TonewoodError("no response of a point is among them", key="FILES")
    scaled = reading.scale * np.array([motion[pair] for pair in pairs], dtype=np.complex128)
    mobility = to_mobility(scaled, responses.freq, reading.form, responses.alpha)
    kept = int(np.count_nonzero(responses.kept))
    remarks = responses.drift.lines(("the force", *hits[0].names))
    if kept == 1:  # its coherence is 1 whatever it holds
        remarks += (f"one hit at {reference}: its noise is taken from the roughness of the response; five tell more",)
    return Responses(
        responses.freq, mobility, pairs, np.array([coherence[pair] for pair in pairs]) if kept > 1 else None,
        kept if kept > 1 else None, responses.alpha, pressure, kept=(kept, len(hits)), remarks=remarks,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Hit:
    fs: float
    force: Floats
    motion: Floats
    names: tuple[str, ...]
    reference: str


def _padded(x: NDArray[np.float64]) -> bool:
    """Whether the last tenth is exactly 0."""
    return not np.any(x[-max(len(x) // 10, 1) :])


def _hit(path: Path, reading: Reading) -> _Hit:
    if path.suffix.lower() == ".wav":
        return _wav_hit(path, reading)
    if path.suffix.lower() == ".csv" and is_documented(path):
        return _csv_hit(path)
    record = record_of_text(path)
    assert record is not None
    time, force, motion, units = record
    if not reading.points:
        raise TonewoodError(
            f"holds a record over time, of {np.ptp(time):.3g} s, of a force and {len(motion)} responses: name the "
            "responses by --points, and the point that was struck by --driving", file=path,
        )  # fmt: skip
    if not reading.sensitivity and any(unit != 1.0 for unit in units):
        shown = ",".join("?" if np.isnan(unit) else f"{unit:g}" for unit in units)
        raise TonewoodError(f"its columns are not in SI units: --sensitivity {shown}", file=path, key="--sensitivity")
    sensitivity = reading.sensitivity or (1.0,) * (1 + len(motion))
    return _scaled(path, _rate(path, time), np.vstack([force, motion]), reading, sensitivity)


def _csv_hit(path: Path) -> _Hit:
    columns = _numbers(path)
    time = columns.pop("time_s")
    forces = [name for name in columns if name.endswith("_force")]
    if len(forces) != 1 or len(columns) < 2:
        raise TonewoodError("wants one column REFERENCE_force and one or more of points", file=path)
    force = columns.pop(forces[0])
    fs = _rate(path, time)
    return _Hit(fs, force, np.array(list(columns.values())), tuple(columns), forces[0].removesuffix("_force"))


def _rate(path: Path, time: Floats) -> float:
    """Samples a second of even times; of times with few digits, some of which repeat, where these lie on a line."""
    step = np.diff(time)
    rounded = time.size > 1 and step.min() == 0 and step.mean() > 0
    even = np.linspace(time[0], time[-1], time.size)
    if rounded and np.abs(time - even).max() <= _ROUNDED * np.ptp(time):
        return float(1 / np.mean(step))
    if time.size < 2 or step.min() <= 0 or step.max() > 1.01 * step.min():
        raise TonewoodError("times are not evenly spaced; a constant step is allowed", file=path, key="time_s")
    return float((time.size - 1) / (time[-1] - time[0]))


def _wav_hit(path: Path, reading: Reading) -> _Hit:
    import soundfile as sf

    try:
        samples, fs = read_samples(path)
    except (sf.LibsndfileError, OSError) as fault:
        raise TonewoodError(f"is no sound file: {str(fault)[:_LONGEST]}", file=path) from None
    if not len(samples):
        raise TonewoodError("holds no samples", file=path)
    clipped = np.flatnonzero(np.abs(samples).max(axis=0) >= 1.0)
    if clipped.size:
        raise TonewoodError(f"is clipped: samples of channel {clipped[0] + 1} reach full scale", file=path)
    return _scaled(path, float(fs), samples.T, reading, reading.sensitivity)


def _scaled(path: Path, fs: float, channels: Floats, reading: Reading, sensitivity: Sequence[float]) -> _Hit:
    """The hit of channels without names, the force first, as the command line names and scales them."""
    n = len(channels)
    if n < 2:
        raise TonewoodError("has one channel; the force and one or more responses are needed", file=path)
    if len(reading.points) != n - 1:
        raise TonewoodError(f"has {n - 1} responses; --points names {len(reading.points)}", file=path, key="--points")
    if len(sensitivity) != n:
        raise TonewoodError(
            f"has {n} channels; --sensitivity gives {len(sensitivity)} numbers", file=path, key="--sensitivity"
        )
    reference = next((name for name, begin in reading.references if path.name.startswith(begin)), None)
    if reference is None:
        raise TonewoodError("the point that the hammer struck is not named", file=path, key="--driving")
    scaled = channels * np.asarray(sensitivity)[:, None]
    return _Hit(fs, scaled[0], scaled[1:], reading.points, reference)
