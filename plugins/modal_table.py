"""A body given by a table of its modes: measured, computed or made up.

The table has one row per mode, ``f_Hz`` (undamped natural frequency) and ``Q`` or ``zeta``, and says the shapes in
one of four ways:

============  ================================================================================================
points        a column per point, the shape there; ``modal_mass`` (kg) if the shapes are not mass-normalised
residues      a column per point, A = phi phi_ref / m (1/kg): the mobility from the point `reference` is
              sum A s / (s^2 + (omega/Q) s + omega^2); phi = A / sqrt(A_ref)
heave_rock    ``heave, cross, rock`` (1/kg): A(u, u') = heave + (u + u') cross + u u' rock for points at u on a line;
              a line that rocks by dz = theta y moves a point h above it by -theta h along y: a point with the
              `lever` h / b, b half of the distance from u = -1 to 1, has the shape -lever times that of the rocking
complex       columns ``NAME_right_re, NAME_right_im, NAME_left_re, NAME_left_im`` per point; y = 2 Re sum r z,
              z' = lambda z + l f (left shapes hold the normalisation)
============  ================================================================================================

Real modes are passive by construction. Complex ones are tested when they are loaded, and refused or repaired.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

import tonewood.authoring as ta
from tonewood.authoring import Parameters

Floats = NDArray[np.float64]

#: an eigenvalue of a residue matrix below this share of the larger one is rounding
RANK_TOLERANCE = 1e-6
#: rows of a table; complex modes are tested by eigenproblems of four times their number
MOST_MODES, MOST_COMPLEX_MODES = 20_000, 1000
MOST_POINTS = 256
#: largest mass-normalised shape, 1/sqrt(kg)
MOST_SHAPE = 1e6
#: m/N, largest residual compliance of a body
MOST_COMPLIANCE = 1.0


class Point(Parameters):
    """A place of the body."""

    direction: ta.Direction = ta.described("x, y, z or a unit vector: displacement is counted along it", default="z")
    u: float | None = ta.quantity("1", default=None, doc="heave_rock: place along the line, -1 .. 1 between the feet")
    lever: float | None = ta.quantity(
        "1",
        low=-1.0,
        high=1.0,
        default=None,
        doc="heave_rock, instead of u: height above the soundboard re half the distance of the feet, moved along y",
    )
    column: str | None = ta.described("name of the point in the table; the point's own where left out", default=None)
    place: tuple[ta.Number, ta.Number] | None = ta.described("[x, y] on the body, m; with `area`", default=None)
    area: float | None = ta.quantity(
        "m^2", low=1e-8, high=1.0, default=None, doc="of the surface that moves as this point: body_microphones hear it"
    )
    driven: bool = ta.described(
        "whether forces act here; false for a point that is only heard, which the test of passivity leaves out",
        default=True,
        strict=True,
    )

    @model_validator(mode="after")
    def _both(self) -> Point:
        if (self.place is None) != (self.area is None):
            raise ValueError("place and area are wanted together, or neither")
        return self


class Truncation(Parameters):
    """Static compliance of modes that the table leaves out."""

    residual_compliance: ta.Number | list[ta.Number] | list[list[ta.Number]] = ta.described(
        "m/N: one number for every point; heave_rock: [heave, cross, rock]; or a matrix over the points", default=0.0
    )


class ModalTableParameters(Parameters):
    """Parameters of the body."""

    table: str = ta.described("CSV file in the bundle")
    shapes: Literal["points", "residues", "heave_rock", "complex"] = ta.described("how the table gives shapes")
    points: dict[str, Point] = ta.described("name -> place and direction", default={}, max_length=MOST_POINTS)
    columns: Literal["named", "all"] = ta.described(
        "points: all makes every further column of the table a point along z", default="named"
    )
    reference: str | None = ta.described("residues: the point at which the table's responses were driven", default=None)
    moved_modes: list[ta.MovedMode] = ta.described("modes of the table with another frequency and Q", default=[])
    truncation: Truncation = ta.described("compliance of modes that are not in the table", default=Truncation())
    damping_case: Literal["complex", "proportional", "block"] = ta.described(
        "complex: modes as they are; proportional: falsely complex; block: damping couples near modes only",
        default="complex",
    )
    repair: Literal["refuse", "passive"] = ta.described(
        "treatment of complex modes that would create energy", default="refuse"
    )
    max_change: float = ta.quantity(
        "1", low=0.0, high=1.0, default=0.1, doc="largest relative change of the mobility a repair may make"
    )

    @model_validator(mode="after")
    def _some(self) -> ModalTableParameters:
        if self.columns == "all" and self.shapes != "points":
            raise ValueError("columns: all is for shapes: points")
        if not self.points and self.columns == "named":
            raise ValueError("points: at least one is wanted, or columns: all")
        return self


class ModalTable(ta.Body[ModalTableParameters]):
    """The body; see the module."""

    api = 1
    Parameters = ModalTableParameters

    def points(self) -> Mapping[str, ta.BodyPoint]:
        """Every point with its direction; of heave_rock with its shares of both, ``heave`` and ``u``."""
        return {
            name: ta.BodyPoint(ta.unit_vector(p.direction), _place(p), driven=p.driven)
            for name, p in self._named.items()
        }

    @cached_property
    def _named(self) -> Mapping[str, Point]:
        """The points of the bundle, and with `columns: all` those of the table's further columns."""
        p = self.parameters
        if p.columns == "named":
            return p.points
        taken = {"f_Hz", "Q", "zeta", "modal_mass", *(point.column for point in p.points.values())}
        names = [name for name in self.files.table(p.table, f"{self.key}.table") if name not in taken]
        return {**{name: Point() for name in names}, **p.points}

    def basis(self, freq_upper: float) -> ta.ModalBasis:
        """Modes below `freq_upper` (Hz).

        Raises
        ------
        BundleError : the table lacks a column, or holds values no body has.
        PassivityError : complex modes would create energy and may not, or cannot, be repaired.
        """
        p = self.parameters
        table = self.files.table(p.table, f"{self.key}.table")
        freq = self._column(table, "f_Hz")
        most = MOST_COMPLEX_MODES if p.shapes == "complex" else MOST_MODES
        if freq.size > most:
            raise self.fault(f"{p.table}: {freq.size} modes; {most} are allowed", "table")
        if ("Q" in table) == ("zeta" in table):
            raise self.fault(f"{p.table}: one column Q or zeta is wanted", "table")
        damping = self._column(table, "Q") if "Q" in table else table["zeta"]
        if np.any(freq <= 0) or np.any(damping <= 0):
            raise self.fault(f"{p.table}: frequencies and Q or zeta must be above 0", "table")
        with np.errstate(over="ignore"):
            zeta = 0.5 / damping if "Q" in table else damping
        if p.moved_modes:
            freq, zeta = self._moved(freq, zeta)
        freq_rad = 2 * np.pi * freq
        if freq_rad.min() < 1e-3 or freq_rad.max() > 1e8 or zeta.min() < 1e-12 or zeta.max() > 1e4:
            raise self.fault(
                f"{p.table}: frequencies from 1 mHz to 10 MHz, zeta from 1e-12 to 1e4 are allowed", "table"
            )
        if p.shapes == "complex":
            basis = self._complex(table, freq_rad, zeta)
        else:
            maker = {"points": self._points, "residues": self._residues, "heave_rock": self._heave_rock}[p.shapes]
            which, shapes = maker(table)
            self._sane(*shapes.values())
            basis = ta.ModalBasis.real(freq_rad[which], (zeta * freq_rad)[which], shapes, residual=self._residual())
        if p.damping_case != "complex":
            try:
                basis = ta.with_damping_case(basis, p.damping_case)
            except ValueError as fault:
                raise self.fault(str(fault), "damping_case") from None
        # some modes of a passive set of complex modes need not be passive: the test is of those that are stepped
        basis = basis.select(np.flatnonzero(basis.natural_freq < freq_upper))
        return basis if basis.is_real else self._passive(basis)

    def sources(self, freq_upper: float) -> ta.plate.Sources | None:
        """Points along z that have an area, each a piston of it; None where there are none or modes are complex."""
        basis = self.basis(freq_upper)
        heard = {
            name: p
            for name, p in self._named.items()
            if p.area is not None and abs(ta.unit_vector(p.direction)[2]) > 0.999
        }
        if not heard or not basis.is_real:
            return None
        areas = np.array([p.area for p in heard.values()], dtype=np.float64)
        signs = np.array([np.sign(ta.unit_vector(p.direction)[2]) for p in heard.values()])
        shapes = np.array([basis.right[basis.index(name)].real for name in heard])
        places = np.array([p.place for p in heard.values()], dtype=np.float64)
        return ta.plate.Sources(places, (areas * signs)[:, None] * shapes, baffled=False)

    def _moved(self, freq: Floats, zeta: Floats) -> tuple[Floats, Floats]:
        """Frequencies and damping ratios with those that the bundle moves."""
        try:
            freq, quality = ta.with_moved_modes(freq, 0.5 / zeta, self.parameters.moved_modes)
        except ValueError as fault:
            raise self.fault(f"{self.parameters.table}: {fault}", "moved_modes") from None
        return freq, 0.5 / quality

    def _column(self, table: Mapping[str, Floats], name: str) -> Floats:
        if name not in table:
            raise self.fault(f"{self.parameters.table}: no column {name!r}; there are {', '.join(table)}", "table")
        return table[name]

    def _columns(self, table: Mapping[str, Floats]) -> dict[str, Floats]:
        return {name: self._column(table, p.column or name) for name, p in self._named.items()}

    def _points(self, table: Mapping[str, Floats]) -> tuple[NDArray[np.intp], dict[str, Floats]]:
        shapes = self._columns(table)
        if not shapes:
            listed = ", ".join(table)
            raise self.fault(f"{self.parameters.table}: no column is a point; there are {listed}", "table")
        mass = table.get("modal_mass", np.ones(1))
        if np.any(mass <= 0):
            raise self.fault(f"{self.parameters.table}: modal masses must be above 0", "table")
        which = np.arange(next(iter(shapes.values())).size)
        return which, {name: phi / np.sqrt(mass) for name, phi in shapes.items()}

    def _residues(self, table: Mapping[str, Floats]) -> tuple[NDArray[np.intp], dict[str, Floats]]:
        columns, reference = self._columns(table), self.parameters.reference
        if reference not in columns:
            raise self.fault(f"names the driven point, one of {', '.join(columns)}; not {reference!r}", "reference")
        driven = columns[reference]
        if np.any(driven <= 0):
            raise self.fault(f"{self.parameters.table}: residues at the driven point must be above 0", "table")
        return np.arange(driven.size), {name: a / np.sqrt(driven) for name, a in columns.items()}

    def _heave_rock(self, table: Mapping[str, Floats]) -> tuple[NDArray[np.intp], dict[str, Floats]]:
        """Each residue matrix by its eigenvectors: one mode, or two at the same frequency."""
        heave, cross, rock = (self._column(table, name) for name in ("heave", "cross", "rock"))
        places: dict[str, Mapping[str, float]] = {}
        for name, point in self.parameters.points.items():
            if (point.u is None) == (point.lever is None):
                raise self.fault("heave_rock needs the place u, or else a lever, of every point", f"points.{name}")
            if ta.unit_vector(point.direction) != ((0.0, 0.0, 1.0) if point.lever is None else (0.0, 1.0, 0.0)):
                raise self.fault(
                    "heave_rock knows motion along z at u, and along y with a lever", f"points.{name}.direction"
                )
            places[name] = _place(point)
        values, vectors = _eigen_2x2(heave, cross, rock)
        largest = values[:, 1:]
        if np.any(largest <= 0) or np.any(values[:, 0] < -RANK_TOLERANCE * largest[:, 0]):
            raise self.fault(f"{self.parameters.table}: a residue matrix is not positive semidefinite", "table")
        row, branch = np.nonzero(values > RANK_TOLERANCE * largest)
        amplitude = np.sqrt(values[row, branch])
        v = vectors[row, :, branch] * amplitude[:, None]
        return row, {name: at["heave"] * v[:, 0] + at["u"] * v[:, 1] for name, at in places.items()}

    def _complex(self, table: Mapping[str, Floats], freq_rad: Floats, zeta: Floats) -> ta.ModalBasis:
        if np.any(zeta >= 1):
            raise self.fault(f"{self.parameters.table}: complex modes need zeta below 1", "table")

        def shapes(side: str) -> dict[str, NDArray[np.complex128]]:
            out = {}
            for name, point in self.parameters.points.items():
                stem = f"{point.column or name}_{side}"
                out[name] = self._column(table, f"{stem}_re") + 1j * self._column(table, f"{stem}_im")
            return out

        right, left = shapes("right"), shapes("left")
        self._sane(*right.values())
        self._sane(*left.values())
        poles = freq_rad * (-zeta + 1j * np.sqrt(1 - zeta**2))
        return ta.ModalBasis.complex(poles, right, left, residual=self._residual())

    def _sane(self, *shapes: NDArray[np.inexact]) -> None:
        """Refuse shapes of modes lighter than a millionth of a milligram, which may overflow."""
        if not all(np.all(np.abs(shape) <= MOST_SHAPE) for shape in shapes):
            raise self.fault(f"{self.parameters.table}: shapes up to {MOST_SHAPE:g} 1/sqrt(kg) are allowed", "table")

    def _residual(self) -> Floats:
        points = self._named
        compliance, n = self.parameters.truncation.residual_compliance, len(points)
        value = np.asarray(compliance, dtype=np.float64)
        if value.ndim == 0:
            out = float(value) * np.eye(n)
        elif value.shape == (3,) and self.parameters.shapes == "heave_rock":
            heave, cross, rock = value
            up, u = np.array([[_place(p).get(key, 0.0) for p in points.values()] for key in ("heave", "u")])
            out = heave * np.outer(up, up) + cross * (np.outer(up, u) + np.outer(u, up)) + rock * np.outer(u, u)
        elif value.shape == (n, n) and np.allclose(value, value.T, rtol=1e-9, atol=0.0):
            out = value
        else:
            raise self.fault(
                f"a number, [heave, cross, rock] with heave_rock, or a symmetric {n} x {n} matrix is wanted",
                "truncation.residual_compliance",
            )
        if np.abs(out).max(initial=0.0) > MOST_COMPLIANCE:
            raise self.fault(f"up to {MOST_COMPLIANCE:g} m/N is allowed", "truncation.residual_compliance")
        smallest = np.linalg.eigvalsh(out)[0]
        if smallest < -1e-9 * np.abs(out).max(initial=0.0):
            raise self.fault("is not positive semidefinite: it would create energy", "truncation.residual_compliance")
        return out

    def _passive(self, basis: ta.ModalBasis) -> ta.ModalBasis:

        p = self.parameters
        driven = [name for name, point in p.points.items() if point.driven]
        report = ta.check_basis(basis, driven)
        if report.passive:
            return basis
        if p.repair == "refuse":
            reason = f"{p.table}: {report.summary()}; `repair: passive` mends it"
            raise ta.PassivityError(reason, file=self.files.manifest, key=self.key)
        try:
            return ta.repair_basis(basis, driven, max_change=p.max_change)
        except ta.PassivityError as fault:
            raise ta.PassivityError(f"{p.table}: {fault.reason}", file=self.files.manifest, key=self.key) from None


def _place(point: Point) -> dict[str, float]:
    """Shares of heave and of the moment about the middle in a point's motion, and of its force in these."""
    if point.lever is not None:
        return {"heave": 0.0, "u": -point.lever}
    return {} if point.u is None else {"heave": 1.0, "u": point.u}


def _eigen_2x2(a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (n, 2), ascending, and vectors (n, 2, 2), columns, of [[a, b], [b, c]]."""
    angle = 0.5 * np.arctan2(2 * b, a - c)
    cos, sin = np.cos(angle), np.sin(angle)
    large = a * cos**2 + 2 * b * cos * sin + c * sin**2
    small = a * sin**2 - 2 * b * cos * sin + c * cos**2
    vectors = np.stack([np.stack([-sin, cos], axis=-1), np.stack([cos, sin], axis=-1)], axis=-1)
    return np.stack([small, large], axis=-1), vectors
