"""The folder of a fit: tables, the parts of a bundle that follow from them, facts, and the figure.

``body.csv``, ``radiation.csv`` (with microphones), ``body.yaml``, ``fit.json``, ``fit.png``; ``modes.csv`` in place of
the first three where responses are no passive body's. All are written, or none.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tonewood import __version__
from tonewood.errors import OutputError
from tonewood.support.whole_files import AtomicFile
from tonewood.workshop.fit.fit import Fit
from tonewood.workshop.fit.radiation import FittedRadiation

#: value of entries without a statement
UNKNOWN = "unknown"
#: files that a fit may write, besides its figure
_ALL = frozenset({"body.csv", "modes.csv", "radiation.csv", "body.yaml", "fit.json", "fit.png"})


@dataclass(frozen=True)
class MeasuredPoint:
    """Place of a point.

    Attributes
    ----------
    direction : x, y or z, or a unit vector: the direction in which the point was driven and measured.
    u : place along the bridge, -1 .. 1, or None.
    """

    direction: str | tuple[float, float, float] = "z"
    u: float | None = None


@dataclass(frozen=True)
class Origin:
    """Origin of the measurement; nothing of it is made up.

    Attributes
    ----------
    title : the object measured.
    measured_by : by whom.
    licence : SPDX name, of the data.
    """

    title: str = UNKNOWN
    measured_by: str = UNKNOWN
    licence: str = UNKNOWN


@dataclass(frozen=True, eq=False)
class FitFolder:
    """All that is written of a fit.

    Attributes
    ----------
    fit : the body.
    radiation : microphones, or None.
    places : point -> where it is; z where left out.
    origin : of the measurement.
    settings : of the command, for ``fit.json``.
    """

    fit: Fit
    radiation: FittedRadiation | None = None
    places: Mapping[str, MeasuredPoint] = field(default_factory=dict)
    origin: Origin = Origin()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def facts(self) -> dict[str, Any]:
        """Return everything but the curves, for JSON."""
        radiation = self.radiation
        heard = None
        if radiation is not None:
            rms = float((radiation.error_db**2).mean() ** 0.5)
            heard = {"channels": list(radiation.channels), "modes": radiation.poles.size, "error_db_rms": rms}
        return {
            "schema": "tonewood-fit/1", "tonewood": __version__, "measured_by": self.origin.measured_by,
            "title": self.origin.title, "licence": self.origin.licence, "settings": dict(self.settings),
            **self.fit.facts(), "radiation": heard,
        }  # fmt: skip

    def parts(self) -> str:
        """Return the keys of an ``instrument.yaml`` that the measurement tells: sources, provenance, body, outputs."""
        r, body, origin = self.fit.responses, self.fit.body, self.origin
        assert body is not None, self.fit.no_body
        files = ", ".join(f"{name} (SHA-256 {sha256})" for name, sha256 in r.files.items()) or UNKNOWN
        band = f"{r.freq[0]:g} to {r.freq[-1]:g} Hz"
        hits = "" if r.kept is None else f", {r.kept[0]} of {r.kept[1]} hits"
        changes = f"{int(body.measured.sum())} modes fitted by tonewood {__version__}: {band}{hits}"
        driven = f"driven at {', '.join(r.references)}"
        beyond = int((~body.measured).sum())
        lines = [
            "# Parts of an instrument.yaml, by `tonewood fit`; `tonewood new NAME --from FOLDER` makes the rest.",
            "sources:",
            "  measurement:",
            f"    text: {_quoted(f'{origin.title}; measured by {origin.measured_by}; {driven}; files: {files}')}",
            f"    licence: {_quoted(origin.licence)}",
            f"    changes: {_quoted(changes)}",
            "provenance:",
            f"  body: {{kind: measured, source: measurement, sha256: {_sha256(self.fit.table())}}}",
            "  body.truncation: {kind: computed, source: measurement, note: "
            + _quoted(f"modes above {r.freq[-1]:g} Hz; {beyond} rows of the table stand for modes beyond the band")
            + "}",
        ]
        if self.radiation is not None:
            sha256 = _sha256(self.radiation.table())
            lines.append(f"  outputs.microphones: {{kind: measured, source: measurement, sha256: {sha256}}}")
        lines += [
            "body:", "  plugin: modal_table", "  table: body.csv", "  shapes: points",
            f"  truncation: {{residual_compliance: {_matrix(body.compliance.tolist())}}}", "  points:",
        ]  # fmt: skip
        lines += [f"    {name}: {_place(self._place(name))}" for name in body.points]
        lines.append("outputs:")
        if self.radiation is not None:
            lines += [
                "  - name: microphones", "    plugin: modal_radiation", "    table: radiation.csv",
                f"    channels: [{', '.join(self.radiation.channels)}]", "    driven_by: bridge_forces",
                f"    low_cut: {self.radiation.low_cut!r}    # Hz; the fit begins at "
                f"{r.freq[0]:g} Hz",
                "    full_scale: 40.0    # Pa at 0 dBFS",
            ]  # fmt: skip
        lines += [
            "  - name: bridge", "    plugin: point_pickup", "    quantity: acceleration",
            f"    at: {{mean: [{', '.join(f'body.{name}' for name in r.references)}]}}",
            "    full_scale: 700.0    # m/s^2 at 0 dBFS",
        ]  # fmt: skip
        return "\n".join(lines) + "\n"

    def _place(self, name: str) -> MeasuredPoint:
        """Place of a point; a bank that was driven at one point takes it for the middle of the bridge."""
        point = self.places.get(name, MeasuredPoint())
        middle = self.radiation is not None and point.u is None and name in self.fit.responses.references
        return replace(point, u=0.0) if middle else point

    def write(self, folder: Path, draw: Callable[[Fit, Path], None] | None = None) -> list[Path]:
        """Write all files into a folder, which is made if it is not there; nothing if one of them fails.

        Parameters
        ----------
        folder : path.
        draw : makes the figure; none is written without it.

        Returns
        -------
        Paths of the files.

        Raises
        ------
        OutputError : the folder cannot be made or written to.
        """
        body = self.fit.body is not None
        texts = {"body.csv" if body else "modes.csv": self.fit.table()}
        if self.radiation is not None:
            texts["radiation.csv"] = self.radiation.table()
        if body:
            texts["body.yaml"] = self.parts()
        texts["fit.json"] = json.dumps(self.facts(), indent=1, allow_nan=False) + "\n"
        new = not folder.exists()
        try:
            folder.mkdir(exist_ok=True)
        except OSError as fault:
            raise OutputError(f"cannot be made: {fault.strerror}", file=folder) from None
        names = [*texts, *(["fit.png"] if draw else [])]
        try:
            with ExitStack() as stack:
                files = []
                for name, text in texts.items():
                    files.append(file := AtomicFile(folder / name))
                    stack.callback(file.discard)
                    file.path.write_bytes(text.encode())
                if draw is not None:
                    files.append(file := AtomicFile(folder / "fit.png"))
                    stack.callback(file.discard)
                    draw(self.fit, file.path)
                for file in files:
                    file.complete()
                for name in _ALL.difference(names):  # of another fit
                    (folder / name).unlink(missing_ok=True)
        except OSError as fault:
            raise OutputError(f"cannot be written: {fault.strerror or fault}", file=folder) from None
        finally:
            if new:  # nothing was completed
                with suppress(OSError):
                    folder.rmdir()
        return [folder / name for name in names]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _quoted(text: str) -> str:
    """A word of YAML, whatever is in it: JSON is YAML."""
    return json.dumps(text, ensure_ascii=False)


def _matrix(rows: list[list[float]]) -> str:
    return "[" + ", ".join("[" + ", ".join(repr(x) for x in row) + "]" for row in rows) + "]"


def _place(point: MeasuredPoint) -> str:
    shown = point.direction if isinstance(point.direction, str) else f"[{', '.join(map(repr, point.direction))}]"
    return f"{{direction: {shown}{'' if point.u is None else f', u: {point.u!r}'}}}"
