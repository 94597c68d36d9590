"""A body from its drawing: outline, wood, braces, bridge, soundhole and cavity give modes; nothing is measured.

The top is an orthotropic Reissner-Mindlin plate with eccentric braces, solved by the Rayleigh-Ritz method with
B-splines; air in cavity and hole is coupled to it, and radiation damps it (`tonewood.physics.plate`). All modes are
real, and so the body is passive. Coordinates of the drawing: x (m) from the neck joint to the tail, y from bass to
treble, z out of the top. A point at height H above the top's middle surface moves by w along z, -H dw/dx along x and
-H dw/dy along y: strings across the bridge feel it rock.

Left out: arching and the strings' static load, neck and sides (mass at the edge), laps of crossing braces,
stiffness of braces across their width, loss that rises with frequency, modes of the cavity along its depth
(above 1.8 kHz at 95 mm), diffraction about the box. Modes above `fmax` keep their static compliance alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

import tonewood.authoring as ta
from tonewood.authoring import Parameters

Floats = NDArray[np.float64]
#: x and y, m
Coordinates = tuple[ta.Number, ta.Number]

#: bytes of a drawing that is read
MOST_SVG = 4_000_000
MOST_BRACES = 100


#: an elastic modulus of a wood, and a loss factor, that may be left out
_modulus = partial(ta.quantity, "Pa", low=1e6, high=1e12, usual=(5e7, 5e10), default=None)
_loss = partial(ta.quantity, "1", low=0.0, high=0.5, default=None)


class WoodParameters(Parameters):
    """A wood by its species, or by its constants; a constant that is given goes before that of the species."""

    species: str | None = ta.described("name in the table of woods", default=None)
    E_L: float | None = _modulus(doc="Young's modulus along the grain")
    E_R: float | None = _modulus(doc="Young's modulus across the grain")
    G_LR: float | None = _modulus(doc="shear modulus in the plate's plane")
    nu_LR: float | None = ta.quantity(
        "1", low=0.0, high=0.99, default=None, doc="Poisson's ratio, pulled along the grain"
    )
    density: float | None = ta.quantity("kg/m^3", low=10.0, high=2e4, default=None, doc="mass per volume")
    loss_L: float | None = _loss(doc="loss factor of E_L")
    loss_R: float | None = _loss(doc="loss factor of E_R")
    loss_shear: float | None = _loss(doc="loss factor of the shear moduli")
    G_LT: float | None = _modulus(doc="shear modulus through the thickness, along the grain")
    G_RT: float | None = _modulus(doc="the same across the grain: rolling shear")

    @model_validator(mode="after")
    def _species_or_values(self) -> WoodParameters:
        if self.species is not None and self.species not in ta.plate.SPECIES:
            raise ValueError(f"there is no species {self.species!r}; there are {', '.join(ta.plate.SPECIES)}")
        values = {k: v for k, v in self.model_dump().items() if v is not None}
        missing = [k for k in ("E_L", "E_R", "G_LR", "nu_LR", "density") if k not in values]
        if self.species is None and missing:
            raise ValueError(f"a species, or {missing[0]} too, is wanted")
        if self.species is None and (self.G_LT is None) != (self.G_RT is None):
            raise ValueError("G_LT and G_RT are wanted together, or neither: the plate then does not shear")
        wood = self.wood()
        if wood.E_R * wood.nu_LR**2 >= wood.E_L:
            raise ValueError(
                f"E_R nu_LR^2 is {wood.E_R * wood.nu_LR**2:.4g}; less than E_L = {wood.E_L:.4g} is allowed"
            )
        return self

    def wood(self) -> ta.plate.Wood:
        """Constants of the species with those that are given in their place."""
        unknown = ta.plate.Wood(0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.02, 0.02)
        base = ta.plate.SPECIES[self.species].wood if self.species else unknown
        return replace(base, **self.model_dump(exclude={"species"}, exclude_none=True))


class GuitarOutline(Parameters):
    """Outline of a guitar, from a made-up shape that is scaled."""

    length: float = ta.quantity("m", low=0.05, high=3.0, doc="of the body, from the neck joint to the tail")
    upper: float = ta.quantity("m", low=0.02, high=2.0, doc="width of the upper bout")
    waist: float = ta.quantity("m", low=0.02, high=2.0, doc="width of the waist")
    lower: float = ta.quantity("m", low=0.02, high=2.0, doc="width of the lower bout")


class SvgOutline(Parameters):
    """A path of a drawing."""

    file: str = ta.described("SVG file in the bundle")
    id: str | None = ta.described("id of the path; the first path where left out", default=None)
    scale: float = ta.quantity("m", low=1e-7, high=10.0, default=1e-3, doc="length of the drawing's unit")


class Outline(Parameters):
    """Outline of a plate, in one of four ways."""

    guitar: GuitarOutline | None = ta.described("a guitar by its length and three widths", default=None)
    points: list[Coordinates] | None = ta.described(
        "[x, y] of its corners, m", default=None, min_length=3, max_length=4000
    )
    table: str | None = ta.described("CSV file in the bundle with columns x and y, m", default=None)
    svg: SvgOutline | None = ta.described("a path of an SVG drawing, y downwards", default=None)
    smooth: bool = ta.described(
        "a smooth curve through the points instead of straight sides", default=False, strict=True
    )

    @model_validator(mode="after")
    def _one_outline(self) -> Outline:
        if sum(getattr(self, way) is not None for way in ("guitar", "points", "table", "svg")) != 1:
            raise ValueError("one of guitar, points, table and svg is wanted")
        return self


class EdgeParameters(Parameters):
    """Fixing of a plate's edge to the sides."""

    kind: Literal["free", "hinged", "clamped", "springs"] = ta.described("how the edge is held", default="clamped")
    k_w: float = ta.quantity(
        "N/m^2", low=0.0, high=1e14, default=0.0, doc="springs: stiffness per length against motion"
    )
    k_theta: float = ta.quantity(
        "N", low=0.0, high=1e10, default=0.0, doc="springs: against turning, per length and angle"
    )
    k_in_plane: float = ta.quantity(
        "N/m^2", low=0.0, high=1e14, default=0.0, doc="stiffness in the plate's plane, per length"
    )
    loss: float = ta.quantity("1", low=0.0, high=0.5, default=0.02, doc="loss factor of these springs")

    def edge(self) -> ta.plate.Edge:
        """Springs of this kind."""
        stiff = {"free": (0.0, 0.0), "hinged": (np.inf, 0.0), "clamped": (np.inf, np.inf)}
        w, theta = stiff.get(self.kind, (self.k_w, self.k_theta))
        return ta.plate.Edge(w, theta, self.k_in_plane, self.loss)


class Brace(Parameters):
    """A brace of rectangular section below the plate, or a bridge above it; its grain runs from start to stop."""

    start: Coordinates = ta.described("[x, y] of its first end, m")
    stop: Coordinates = ta.described("[x, y] of its other end, m")
    width: float = ta.quantity("m", low=1e-4, high=0.5, doc="of its section, in the plate's plane")
    height: ta.Number | list[ta.Number] = ta.described(
        "m, of its section; a list for heights spread evenly from start to stop"
    )
    wood: WoodParameters | None = ta.described("of which it is made; that of the plate where left out", default=None)
    above: bool = ta.described("whether it stands on the plate instead of hanging below", default=False, strict=True)

    @model_validator(mode="after")
    def _solid(self) -> Brace:
        heights = self.height if isinstance(self.height, list) else [self.height]
        if not heights or not all(1e-5 <= h <= 0.5 for h in heights):
            raise ValueError("heights from 1e-05 to 0.5 m are allowed")
        if self.start == self.stop:
            raise ValueError("start and stop are the same place")
        return self


class ThicknessMap(Parameters):
    """A thickness that differs from place to place."""

    table: str = ta.described(
        "CSV file in the bundle with columns x, y and h (m) of a full grid; linear between its points"
    )


class PlateParameters(Parameters):
    """A plate: the top, or the back."""

    wood: WoodParameters = ta.described("of the plate")
    thickness: ta.Number | ThicknessMap = ta.described("m")
    grain_deg: float = ta.quantity(
        "degree", low=-180.0, high=180.0, default=0.0, doc="angle of the grain from x towards y"
    )
    edge: EdgeParameters = ta.described("how the sides hold it", default=EdgeParameters())
    braces: dict[str, Brace] = ta.described("name -> brace", default={}, max_length=MOST_BRACES)

    @model_validator(mode="after")
    def _thick(self) -> PlateParameters:
        if isinstance(self.thickness, float) and not 1e-4 <= self.thickness <= 0.1:
            raise ValueError(f"thickness is {self.thickness:g} m; 0.0001 to 0.1 m are allowed")
        return self


class Soundhole(Parameters):
    """A round hole in the top."""

    centre: Coordinates = ta.described("[x, y], m")
    radius: float = ta.quantity("m", low=1e-3, high=1.0, doc="of the hole")


class Air(Parameters):
    """The air in the body."""

    depth: float = ta.quantity("m", low=1e-3, high=2.0, doc="of the cavity between top and back")
    cavity_to: float = ta.quantity(
        "Hz", low=0.0, high=4e3, default=1600.0, doc="modes of the cavity below it take part"
    )
    end_correction: float = ta.quantity(
        "1", low=0.0, high=3.0, default=1.5, doc="length of air beside the hole, in radii, both ends together"
    )
    loss: float = ta.quantity("1", low=0.0, high=0.5, default=0.02, doc="loss factor of the air")


class PlatePoint(Parameters):
    """A place of the top: where a string ends, a finger taps, a pickup reads."""

    at: Coordinates = ta.described("[x, y], m")
    direction: ta.Direction = ta.described("x, y, z or a unit vector: displacement is counted along it", default="z")
    height: float | None = ta.quantity(
        "m", low=0.0, high=0.5, default=None, doc="above the top's middle surface; saddle_height where left out"
    )
    driven: bool = ta.described("whether forces act here", default=True, strict=True)


class DrawnBodyParameters(PlateParameters):
    """Parameters of the body: those of its top, and the rest."""

    outline: Outline = ta.described("of top and back")
    soundhole: Soundhole | None = ta.described("in the top; none where left out", default=None)
    bridge: Brace | None = ta.described("a beam glued on the top; none where left out", default=None)
    air: Air | None = ta.described("behind the top; a plate in the open where left out", default=None)
    back: PlateParameters | Literal["rigid"] = ta.described(
        "a second plate of the same outline, or rigid", default="rigid"
    )
    baffle: Literal["none", "infinite"] = ta.described(
        "none: the body radiates as in free air; infinite: from a rigid wall", default="none"
    )
    fmax: float = ta.quantity("Hz", low=50.0, high=2e4, default=6000.0, doc="highest mode")
    cell: float | None = ta.quantity("m", low=1e-3, high=0.2, default=None, doc="size of a cell of the solution's grid")
    extra_loss: float = ta.quantity(
        "1", low=0.0, high=0.5, default=0.008, doc="loss factor added to wood: glue, edge, finish"
    )
    saddle_height: float = ta.quantity(
        "m", low=0.0, high=0.2, default=0.01, doc="of strings above the top's middle surface"
    )
    points: dict[str, PlatePoint] = ta.described(
        "name -> place and direction; `corner`, a place near the first point of the outline, where left out",
        default={},
        max_length=256,
    )


class DrawnBody(ta.Body[DrawnBodyParameters]):
    """The body; see the module."""

    api = 1
    Parameters = DrawnBodyParameters
    preview = MappingProxyType({"fmax": 1000.0, "cell": 0.04})

    def points(self) -> Mapping[str, ta.BodyPoint]:
        """Every point with its direction and place."""
        return {
            name: ta.BodyPoint(ta.unit_vector(p.direction), {"x": p.at[0], "y": p.at[1]}, driven=p.driven)
            for name, p in self._places.items()
        }

    @cached_property
    def _places(self) -> Mapping[str, PlatePoint]:
        """Points of the drawing, or one near a corner of the outline, where every mode of a free plate moves."""
        if self.parameters.points:
            return self.parameters.points
        ring = self._outline()
        x, y = ring[0] + 0.04 * (ring.mean(axis=0) - ring[0])
        return {"corner": PlatePoint(at=(float(x), float(y)))}

    def basis(self, freq_upper: float) -> ta.ModalBasis:
        """Modes below `freq_upper` (Hz) and `fmax`.

        Raises
        ------
        BundleError : the drawing has no such body: says where.
        """
        modes = self.modes_below(freq_upper)
        omega = 2 * np.pi * modes.freq
        shapes = dict(zip(self._places, modes.shapes, strict=True))
        heard = np.divide(modes.radiation_loss, modes.loss, out=np.zeros(len(omega)), where=modes.loss > 0)
        return ta.ModalBasis.real(
            omega, modes.loss * omega / 2, shapes, residual=modes.residual, metadata={"radiated": heard}
        )

    def sources(self, freq_upper: float) -> ta.plate.Sources:
        """Squares of 10 mm of the top, and the hole."""
        modes, drawing = self.modes_below(freq_upper), self.drawing
        rings = (drawing.outline,) if drawing.hole is None else (drawing.outline, drawing.hole)
        behind = np.column_stack([modes.back_sources, np.full(len(modes.back_sources), -drawing.depth)])
        return ta.plate.Sources(
            modes.sources,
            modes.volumes,
            drawing.baffled,
            modes.areas,
            rings,
            modes.labels(),
            behind,
            modes.back_volumes,
        )

    def modes_below(self, freq_upper: float) -> ta.plate.BodyModes:
        """All that is known of the modes below `freq_upper` (Hz), computed once for a drawing."""
        return self._modes.below(freq_upper)

    @cached_property
    def _modes(self) -> ta.plate.BodyModes:
        try:
            arrays = ta.cached_arrays(self._inputs(), lambda: ta.plate.body_modes(self.drawing).arrays())
        except ValueError as fault:
            raise self.fault(str(fault), "fmax") from None
        return ta.plate.BodyModes(**arrays)

    def _inputs(self) -> dict[str, Any]:
        """All that decides on the modes: parameters, and the hash of every file of the drawing."""
        p, hashes = self.parameters, []
        plates = [p] if isinstance(p.back, str) else [p, p.back]
        names = [p.outline.table, p.outline.svg.file if p.outline.svg else None]
        names += [q.thickness.table for q in plates if isinstance(q.thickness, ThicknessMap)]
        for name in names:
            if name is not None:
                hashes.append(hashlib.sha256(self.files.path(name, self.key).read_bytes()).hexdigest())
        return {"body": p.model_dump(mode="json"), "files": hashes}

    def mass(self) -> float:
        """Top and back with braces and bridge."""
        return float(self._modes.masses.sum())

    def facts(self) -> Sequence[str]:
        """A0 and T1, mass, modes of top and air by themselves, and T1 on other edges."""
        modes = self._modes
        named = modes.named()
        called = ", ".join(f"{k} {modes.freq[i]:.1f} Hz (Q {1 / modes.loss[i]:.0f})" for k, i in sorted(named.items()))
        lines = [
            f"{len(modes.freq)} modes to {modes.freq.max():.0f} Hz; {called or 'no mode is an A0 or T1'}",
            f"top {1e3 * modes.masses[0]:.0f} g with braces and bridge; in vacuum "
            + " ".join(f"{f:.0f}" for f in modes.vacuum_freq[:5])
            + " Hz",
        ]
        point = next(iter(self._places))
        flexible = modes.freq > 0
        if not flexible.all():
            lines.append(
                f"{np.count_nonzero(~flexible)} of these are rigid-body motion at 0 Hz: nothing holds the body"
            )
        kept = float(modes.residual[0, 0])
        whole = kept + float(((modes.shapes[0, flexible] / (2 * np.pi * modes.freq[flexible])) ** 2).sum())
        lines.append(
            f"modes above {self.parameters.fmax:g} Hz are not stepped; their static compliance is kept, "
            f"{100 * kept / whole:.2g} % of that at {point}"
        )
        for name, wood in self._woods():
            if not wood.shears:
                lines.append(f"{name} gives no G_LT and G_RT: the plate does not shear, and its modes are too high")
        if len(modes.cavity_freq):
            rigid = " ".join(f"{f:.0f}" for f in modes.cavity_freq[:5])
            lines.append(f"cavity with rigid walls {rigid} Hz")
        if "T1" in named:
            hinged, clamped = self._on_other_edges()
            lines.append(
                f"T1 is {modes.freq[named['T1']]:.1f} Hz on this edge ({self.parameters.edge.kind}), {hinged:.1f} Hz "
                f"hinged, {clamped:.1f} Hz clamped: its stiffness is seldom known"
            )
            share = modes.radiation_loss[named["T1"]] / modes.loss[named["T1"]]
            lines.append(f"{100 * share:.0f} % of the loss of T1 is radiated")
        return lines

    def _woods(self) -> list[tuple[str, ta.plate.Wood]]:
        """Key and wood of each plate."""
        p = self.parameters
        backs = [] if isinstance(p.back, str) else [("back.wood", p.back.wood.wood())]
        return [("wood", p.wood.wood()), *backs]

    def _on_other_edges(self) -> tuple[float, float]:
        """T1 (Hz) on a hinged and on a clamped edge; 0 where there is none."""

        def computed() -> dict[str, Floats]:
            modes = ta.plate.first_modes(self.drawing, [ta.plate.Edge(np.inf, 0.0), ta.plate.Edge(np.inf, np.inf)])
            return {"T1": np.array([f.get("T1", 0.0) for f in modes])}

        hinged, clamped = ta.cached_arrays({"edges": self._inputs()}, computed)["T1"]
        return float(hinged), float(clamped)

    @cached_property
    def drawing(self) -> ta.plate.BodyDrawing:
        """The drawing as arrays, checked.

        Raises
        ------
        BundleError : an outline crosses itself, something lies outside of it or in the hole; says where.
        """
        p = self.parameters
        outline = self._outline()
        hole = None if p.soundhole is None else ta.plate.circle(p.soundhole.radius, p.soundhole.centre, 360)
        if hole is not None and (
            not ta.plate.inside(hole, [outline]).all() or ta.plate.crossing(hole, outline) is not None
        ):
            raise self.fault(f"the hole about {_shown(hole.mean(axis=0))} leaves the outline", "soundhole")
        rings = [outline] if hole is None else [outline, hole]
        beams = {f"braces.{name}": b for name, b in p.braces.items()} | ({"bridge": p.bridge} if p.bridge else {})
        top = self._plate(p, rings, beams, above="bridge")
        for name, point in self._places.items():
            if not ta.plate.inside([point.at], rings)[0]:
                raise self.fault(f"{_shown(point.at)} is not on the top", f"points.{name}.at")
        back = None
        if not isinstance(p.back, str):
            if p.air is None:
                raise self.fault("a back needs air in front of it", "back")
            back = self._plate(p.back, [outline], {f"back.braces.{n}": b for n, b in p.back.braces.items()})
        every = list(self._places.values())
        air = p.air or Air(depth=1e-3)
        return ta.plate.BodyDrawing(
            outline=outline,
            hole=hole,
            top=top,
            back=back,
            depth=air.depth if p.air else 0.0,
            cavity_to=air.cavity_to,
            end_correction=air.end_correction,
            air_loss=air.loss,
            extra_loss=p.extra_loss,
            baffled=p.baffle == "infinite",
            fmax=p.fmax,
            points=np.array([q.at for q in every], dtype=np.float64),
            directions=np.array([ta.unit_vector(q.direction) for q in every]),
            heights=np.array([p.saddle_height if q.height is None else q.height for q in every]),
        )

    def _plate(
        self, p: PlateParameters, rings: list[Floats], beams: Mapping[str, Brace], above: str = ""
    ) -> ta.plate.PlateDrawing:
        parts = []
        for name, brace in beams.items():
            start, stop = np.array(brace.start), np.array(brace.stop)
            samples = start + np.linspace(0.0, 1.0, 201)[:, None] * (stop - start)
            fine = ta.plate.inside(samples, rings)
            if not fine.all():
                where = samples[np.argmin(fine)]
                which = "in the soundhole" if ta.plate.inside([where], rings[:1])[0] else "outside of the outline"
                raise self.fault(f"{_shown(where)} is {which}", name)
            wood = (brace.wood or p.wood).wood()
            heights = np.atleast_1d(np.asarray(brace.height, dtype=np.float64))
            parts.append(ta.plate.Beam(start, stop, brace.width, heights, wood, brace.above or name == above))
        edge, grain = p.edge.edge(), float(np.radians(p.grain_deg))
        cell = self.parameters.cell or 0.0
        return ta.plate.PlateDrawing(p.wood.wood(), self._thickness(p.thickness), edge, parts, grain, cell)

    def _thickness(self, thickness: float | ThicknessMap) -> Any:
        if isinstance(thickness, float):
            return thickness
        from scipy.interpolate import RegularGridInterpolator

        table = self.files.table(thickness.table, f"{self.key}.thickness.table")
        missing = [name for name in ("x", "y", "h") if name not in table]
        if missing:
            raise self.fault(f"{thickness.table}: no column {missing[0]!r}", "thickness.table")
        x, y = np.unique(table["x"]), np.unique(table["y"])
        order = np.lexsort((table["y"], table["x"]))
        whole = len(order) == len(x) * len(y) and len(x) > 1 < len(y)
        if not whole or not np.array_equal(table["y"][order].reshape(len(x), -1), np.tile(y, (len(x), 1))):
            raise self.fault(f"{thickness.table}: a full grid of x and y is wanted", "thickness.table")
        h = table["h"][order].reshape(len(x), len(y))
        if h.min() < 1e-4 or h.max() > 0.1:
            raise self.fault(f"{thickness.table}: h from 0.0001 to 0.1 m is allowed", "thickness.table")
        between = RegularGridInterpolator((x, y), h)
        low, high = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
        return lambda places: between(np.clip(places, low, high))

    def _outline(self) -> Floats:
        p = self.parameters.outline
        if p.guitar is not None:
            ring = ta.plate.guitar_outline(p.guitar.length, p.guitar.upper, p.guitar.waist, p.guitar.lower)
            coarse = ring[::8]
        else:
            corners = np.array(p.points, dtype=np.float64) if p.points is not None else self._read_outline()
            ring = ta.plate.smooth_ring(corners) if p.smooth else corners
            coarse = ring
        if len(ring) > 8000:
            raise self.fault(f"{len(ring)} points; 8000 are allowed", "outline")
        crossings = ta.plate.crossing(coarse)
        if crossings is not None:
            raise self.fault(f"the outline crosses itself at {_shown(crossings)}", "outline")
        if ta.plate.area(ring) < 1e-4 or np.ptp(ring, axis=0).max() > 5.0:
            raise self.fault(
                f"encloses {ta.plate.area(ring):.3g} m^2; 1 cm^2 and more, up to 5 m long, are allowed", "outline"
            )
        return ring

    def _read_outline(self) -> Floats:
        p = self.parameters.outline
        if p.table is not None:
            table = self.files.table(p.table, f"{self.key}.outline.table")
            if "x" not in table or "y" not in table:
                raise self.fault(f"{p.table}: columns x and y are wanted", "outline.table")
            if len(table["x"]) < 3:
                raise self.fault(f"{p.table}: three points or more are wanted", "outline.table")
            return np.column_stack([table["x"], table["y"]])
        assert p.svg is not None
        data = self.files.path(p.svg.file, f"{self.key}.outline.svg.file").read_bytes()
        if len(data) > MOST_SVG or b"<!ENTITY" in data:
            raise self.fault(f"{p.svg.file}: up to {MOST_SVG} bytes without entities are allowed", "outline.svg.file")
        try:
            paths = [e for e in ElementTree.fromstring(data).iter() if e.tag.rpartition("}")[2] == "path"]
        except ElementTree.ParseError as fault:
            raise self.fault(f"{p.svg.file}: {fault}", "outline.svg.file") from None
        named = [e for e in paths if p.svg.id in (None, e.get("id"))]
        if not named:
            names = ", ".join(e.get("id") or "(no id)" for e in paths) or "none"
            raise self.fault(f"{p.svg.file}: there is no path {p.svg.id!r}; there are {names}", "outline.svg.id")
        try:
            ring = ta.svg_ring(named[0].get("d") or "")
        except ValueError as fault:
            raise self.fault(f"{p.svg.file}: {fault}", "outline.svg") from None
        return np.asarray(ring * [p.svg.scale, -p.svg.scale])


def _shown(position: Any) -> str:
    """A place in millimetres, for errors."""
    return f"x {1e3 * position[0]:.1f} mm, y {1e3 * position[1]:.1f} mm"
