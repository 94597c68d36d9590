"""Universal files: data sets 58 (responses, coherences) with the units of data set 164."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes
from tonewood.workshop.fit.arrays import Pair, ResponseTable

#: end of the name of a microphone
MICROPHONE = "_Pa"
#: what begins and ends a data set
_BOUND = b"    -1"
#: characters of another library's message that are shown
_LONGEST = 64
#: functions that data sets 58 hold
_FUNCTIONS = {1: "time response", 2: "auto spectrum", 3: "cross spectrum", 6: "coherence", 9: "power spectral density",
              12: "spectrum"}  # fmt: skip
#: numbers that UFF gives the ordinate, and a pressure among them; its number for a force
_ORDINATES = {8: "receptance", 11: "mobility", 12: "accelerance"}
_PRESSURE, _FORCES = 15, (0, 13)
#: what UFF calls the places of response and force
_ENDS = ("rsp", "ref")


def responses_of_uff(path: Path) -> ResponseTable:
    """Read the responses of a universal file. Raises TonewoodError : it holds none, or is cut off; one line."""
    try:
        import pyuff
    except ModuleNotFoundError:
        raise TonewoodError('needs pyuff: pip install "tonewood[fit]"', file=path) from None
    try:
        data_sets: Any = pyuff.UFF(str(path)).read_sets()
    except Exception as fault:  # the reader raises bare exceptions of every kind
        raise TonewoodError(f"is no universal file: {str(fault)[:_LONGEST]}", file=path) from None
    _whole(path)
    sets = [x for x in (data_sets if isinstance(data_sets, list) else [data_sets]) if x["type"] == 58]

    def pair(x: Mapping[str, Any]) -> Pair:
        heard = MICROPHONE if int(x["ordinate_spec_data_type"]) == _PRESSURE else ""
        ends = [(str(x[f"{end}_ent_name"]).strip(), int(x[f"{end}_node"]), abs(int(x[f"{end}_dir"]))) for end in _ENDS]
        if ends[0][:2] == ends[1][:2] and not ends[1][2]:  # no direction is stated where it was driven
            ends[1] = ends[0]
        point, reference = (f"{name + '.' if parts > 1 else ''}{node}+{axis}" for name, node, axis in ends)
        return point + heard, reference

    def sign(x: Mapping[str, Any]) -> float:
        heard = int(x["ordinate_spec_data_type"]) == _PRESSURE
        return float(np.prod([-1.0 for end in _ENDS[heard:] if int(x[f"{end}_dir"]) < 0]))

    responses = [x for x in sets if x["func_type"] == 4]
    parts = len({str(x[f"{end}_ent_name"]).strip() for x in responses for end in _ENDS})
    if not responses:
        others = sorted({_FUNCTIONS.get(int(x["func_type"]), f"function type {x['func_type']}") for x in sets})
        raise TonewoodError(
            "holds no frequency response (data set 58, function type 4)"
            + (f"; its {len(sets)} sets 58 are of: {', '.join(others)}" if sets else ""), file=path,
        )  # fmt: skip
    ordinates = {int(x["ordinate_spec_data_type"]) for x in responses} - {_PRESSURE}
    forms = {_ORDINATES.get(ordinate) for ordinate in ordinates}
    if len(stated := sorted(form for form in forms if form)) > 1:
        raise TonewoodError(f"holds responses of different quantities: {', '.join(stated)}", file=path)
    freq = np.asarray(responses[0]["x"], dtype=np.float64)
    if any(len(x["x"]) != len(freq) for x in responses):
        raise TonewoodError("holds responses of different frequencies", file=path)
    if any("rad" in str(x.get("abscissa_axis_units_lab", "")).lower() for x in responses):
        raise TonewoodError("its frequencies are in rad/s: divide them by 2 pi, data sets 58 are in Hz", file=path)
    if any(int(x["orddenom_spec_data_type"]) not in _FORCES for x in responses):
        raise TonewoodError("holds responses to something else than a force", file=path)
    per_force, per_length = _uff_units(data_sets)

    def unit(x: Mapping[str, Any]) -> float:
        return per_force if int(x["ordinate_spec_data_type"]) == _PRESSURE else per_force / per_length

    rows: dict[Pair, Complexes] = {}
    for x in responses:
        if pair(x) in rows:
            raise TonewoodError("is in it twice; one response of a pair is allowed", file=path, key=":".join(pair(x)))
        rows[pair(x)] = sign(x) * unit(x) * np.asarray(x["data"], dtype=np.complex128)
    coherence = {pair(x): np.asarray(x["data"]).real.astype(np.float64) for x in sets if x["func_type"] == 6}
    form = forms.pop() if len(forms) == 1 else None
    return ResponseTable(freq, rows, coherence, form, _missing_nodes(path, data_sets, responses))


def _missing_nodes(path: Path, data_sets: Any, responses: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Say which nodes have no response: of the geometry (data set 15), else in the row of their numbers."""
    moved, driven = ({int(x[f"{end}_node"]) for x in responses} for end in _ENDS)
    nodes = moved if len(moved) >= len(driven) else driven
    sets = data_sets if isinstance(data_sets, list) else [data_sets]
    listed = {int(n) for x in sets if x["type"] == 15 for n in x["node_nums"]}
    missing = sorted((listed or set(range(min(nodes), max(nodes) + 1))) - nodes)
    if not missing or len(missing) > len(nodes):
        return ()
    shown = ", ".join(map(str, missing[:6])) + (" ..." if len(missing) > 6 else "")
    return (f"{path.name} has no response at {len(missing)} of its nodes: {shown}; sets may be missing",)


def _whole(path: Path) -> None:
    """Refuse a universal file that ends within a data set: the reader passes over it."""
    lines = path.read_bytes().splitlines()
    marks = [i for i, line in enumerate(lines) if _bounds(line.rstrip())]
    if len(marks) % 2 == 0:
        return
    begun, words = (len(marks) + 1) // 2, []
    if len(lines) > marks[-1] + 7 and lines[marks[-1] + 1].split()[0].startswith(b"58"):
        words = lines[marks[-1] + 7].decode("ascii", "replace").split()
    which = f" (response at node {words[5]} to node {words[8]})" if len(words) >= 10 else ""
    raise TonewoodError(
        f"is cut off: it ends within its data set {begun}{which}, and sets may be missing after it; copy it again, or "
        "remove the incomplete set", file=path,
    )  # fmt: skip


def _bounds(line: bytes) -> bool:
    """Whether a line bounds a data set: after binary numbers there is no line break before it."""
    before = line.removesuffix(_BOUND)
    if before == line:
        return False
    return len(before) <= 4 or not all(32 <= byte < 127 for byte in before)


def _uff_units(data_sets: Any) -> tuple[float, float]:
    """Units of force and length of the file per SI unit (data set 164); 1 where it does not say."""
    for x in data_sets if isinstance(data_sets, list) else [data_sets]:
        if x["type"] == 164:
            return float(x["force"]), float(x["length"])
    return 1.0, 1.0
