"""Drawings of bodies as arrays, before any mode is computed; gongs and their switch; by closed forms and by hand."""

from __future__ import annotations

import math
import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

import numpy as np
import pytest
from tonewood.plugins.gong import LARGE_DEFLECTION, LargeDeflection, PlateEnergy, stiffening

import tonewood.authoring as ta
from tonewood.errors import BundleError
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import plugin
from tonewood.physics.modal.modes import ModalBasis

SMALL: dict[str, Any] = {
    "outline": {"points": [[0, 0], [0.3, 0], [0.3, 0.2], [0, 0.2]]},
    "wood": {"species": "sitka_spruce"},
    "thickness": 3e-3,
    "points": {"a": {"at": [0.15, 0.1]}, "b": {"at": [0.1, 0.06], "direction": "y", "height": 0.02, "driven": False}},
}


def drawn(folder: Path | None = None, **values: Any) -> Any:
    files = None if folder is None else Files(folder, folder / "instrument.yaml")
    return plugin("drawn_body", "body").from_values(SMALL | values, files, "body")


def test_a_drawing_has_the_numbers_of_its_bundle() -> None:
    body = drawn(
        soundhole={"centre": [0.07, 0.1], "radius": 0.03},
        air={"depth": 0.08, "cavity_to": 900.0, "end_correction": 1.2, "loss": 0.03},
        back={"wood": {"species": "maple"}, "thickness": 2.5e-3, "grain_deg": 90.0, "edge": {"kind": "free"}},
        bridge={"start": [0.2, 0.05], "stop": [0.2, 0.15], "width": 0.02, "height": [0.01, 0.006]},
        braces={
            "x": {
                "start": [0.12, 0.05],
                "stop": [0.16, 0.15],
                "width": 0.008,
                "height": 0.012,
                "wood": {"species": "maple"},
            },
            "y": {"start": [0.25, 0.05], "stop": [0.25, 0.15], "width": 0.008, "height": 0.01, "above": True},
        },
        grain_deg=30.0,
        fmax=1500.0,
        cell=0.02,
        extra_loss=0.005,
        saddle_height=0.012,
        baffle="infinite",
        edge={"kind": "springs", "k_w": 1e6, "k_theta": 200.0, "k_in_plane": 5e5, "loss": 0.03},
    )
    found = body.drawing
    assert found.outline.tolist() == SMALL["outline"]["points"]
    assert np.hypot(*(found.hole - [0.07, 0.1]).T) == pytest.approx(np.full(360, 0.03), rel=1e-4)
    assert (found.depth, found.cavity_to, found.end_correction, found.air_loss) == (0.08, 900.0, 1.2, 0.03)
    assert (found.extra_loss, found.baffled, found.fmax) == (0.005, True, 1500.0)
    assert found.points.tolist() == [[0.15, 0.1], [0.1, 0.06]]
    assert found.directions.tolist() == [[0, 0, 1], [0, 1, 0]]
    assert found.heights.tolist() == [0.012, 0.02]
    top, back = found.top, found.back
    assert (top.thickness, top.grain, top.size) == (3e-3, pytest.approx(math.pi / 6), 0.02)
    assert (top.edge.k_w, top.edge.k_theta, top.edge.k_in_plane, top.edge.loss) == (1e6, 200.0, 5e5, 0.03)
    assert top.wood == ta.plate.SPECIES["sitka_spruce"].wood
    x, y, bridge = top.beams
    assert (x.length, x.width, x.above, x.wood) == (
        pytest.approx(math.hypot(0.04, 0.1)),
        0.008,
        False,
        ta.plate.SPECIES["maple"].wood,
    )
    assert (y.above, y.wood == top.wood, bridge.above) == (True, True, True)
    assert bridge.height(np.array([0.0, 0.5, 1.0])).tolist() == pytest.approx([0.01, 0.008, 0.006])
    assert (back.thickness, back.grain, back.wood) == (
        2.5e-3,
        pytest.approx(math.pi / 2),
        ta.plate.SPECIES["maple"].wood,
    )
    assert (back.edge.k_w, back.edge.k_theta, back.beams) == (0.0, 0.0, [])
    points = body.points()
    assert (points["a"].direction, points["a"].coordinates, points["b"].driven) == (
        (0, 0, 1),
        {"x": 0.15, "y": 0.1},
        False,
    )
    plain = drawn().drawing
    assert (plain.depth, plain.back, plain.hole, plain.baffled, plain.top.size) == (0.0, None, None, False, 0.0)
    assert (plain.top.edge.k_w, plain.top.edge.k_theta) == (math.inf, math.inf)
    assert drawn(edge={"kind": "hinged"}).drawing.top.edge.k_theta == 0.0


def test_a_body_without_points_has_one_near_its_first_corner() -> None:
    """4 % of the way to the mean of the corners."""
    (name,) = (body := drawn(points={})).points()
    assert name == "corner"
    assert body.drawing.points[0] == pytest.approx([0.04 * 0.15, 0.04 * 0.1])


def test_a_wood_s_own_constants_come_before_those_of_its_species() -> None:
    maple = ta.plate.SPECIES["maple"].wood
    wood = drawn(wood={"species": "maple", "E_L": 9e9, "loss_L": 0.5}).drawing.top.wood
    assert (wood.E_L, wood.loss_L, wood.E_R, wood.density, wood.G_RT) == (
        9e9,
        0.5,
        maple.E_R,
        maple.density,
        maple.G_RT,
    )
    own = {"E_L": 1e10, "E_R": 1e9, "G_LR": 8e8, "nu_LR": 0.3, "density": 450.0}
    bare = drawn(wood=own).drawing.top.wood
    assert (bare.loss_L, bare.loss_R, bare.loss_shear, bare.shears) == (0.01, 0.02, 0.02, False)
    for values, said in (
        ({**own, "G_LT": 1e9}, "G_LT and G_RT are wanted together"),
        ({"species": "cheese"}, "there is no species 'cheese'"),
        ({**own, "E_L": 0.09e9}, "E_R nu_LR\\^2 is 9e\\+07; less than E_L = 9e\\+07"),
    ):
        with pytest.raises(BundleError, match=said):
            drawn(wood=values)
    assert drawn(wood={**own, "E_L": 0.0901e9}).drawing.top.wood.E_L == 0.0901e9


def test_a_thickness_map_is_linear_between_its_points_and_even_beyond(tmp_path: Path) -> None:
    rows = [
        (x, y, h) for (x, y), h in zip([(0, 0), (0, 0.2), (0.3, 0), (0.3, 0.2)], [2e-3, 3e-3, 4e-3, 5e-3], strict=True)
    ]
    (tmp_path / "h.csv").write_text("x,y,h\n" + "".join(f"{x},{y},{h}\n" for x, y, h in reversed(rows)))
    thickness = drawn(tmp_path, thickness={"table": "h.csv"}).drawing.top.thickness
    places = np.array([[0.0, 0.0], [0.15, 0.0], [0.15, 0.1], [0.3, 0.2], [-1.0, -1.0], [9.0, 0.1]])
    assert thickness(places) == pytest.approx([2e-3, 3e-3, 3.5e-3, 5e-3, 2e-3, 4.5e-3])
    for text, said in (("x,y,h\n0,0,1e-3\n0,1,1e-3\n1,0,1e-3\n", "a full grid"), ("x,y\n0,0\n", "no column 'h'"),
                       ("x,y,h\n0,0,9e-5\n0,1,1e-3\n1,0,1e-3\n1,1,1e-3\n", "h from 0.0001 to 0.1 m"),
                       ("x,y,h\n0,0,0.11\n0,1,1e-3\n1,0,1e-3\n1,1,1e-3\n", "h from 0.0001 to 0.1 m")):  # fmt: skip
        (tmp_path / "h.csv").write_text(text)
        with pytest.raises(BundleError, match=said):
            _ = drawn(tmp_path, thickness={"table": "h.csv"}).drawing


def test_outlines_of_tables_drawings_and_guitars(tmp_path: Path) -> None:
    (tmp_path / "o.csv").write_text("x,y\n0,0\n0.4,0\n0.4,0.3\n0,0.3\n")
    from_table = drawn(tmp_path, outline={"table": "o.csv"}).drawing.outline
    assert from_table.tolist() == [[0, 0], [0.4, 0], [0.4, 0.3], [0, 0.3]]
    (tmp_path / "o.svg").write_text('<svg><path id="p" d="M0 0L200 0L200 -150L0 -150Z"/></svg>')
    scaled = drawn(tmp_path, outline={"svg": {"file": "o.svg", "scale": 2e-3}}).drawing.outline
    assert scaled == pytest.approx(np.array([[0, 0], [0.4, 0], [0.4, 0.3], [0, 0.3]]))
    smooth = drawn(tmp_path, outline={"table": "o.csv", "smooth": True}).drawing.outline
    assert len(smooth) > 4
    widths = {"length": 0.5, "upper": 0.28, "waist": 0.24, "lower": 0.37}
    guitar = drawn(outline={"guitar": widths}, points={"a": {"at": [0.35, 0.0]}}).drawing.outline
    assert np.ptp(guitar, axis=0) == pytest.approx([0.5, 0.37], rel=0.01)
    for outline, said in (
        ({"points": [[0, 0], [0.01, 0], [0, 0.0199]]}, "1 cm\\^2 and more"),
        ({"points": [[0, 0], [5.1, 0], [0, 1]]}, "up to 5 m long"),
        ({"table": "o.csv", "points": [[0, 0], [1, 0], [0, 1]]}, "one of guitar, points, table and svg"),
        ({}, "one of guitar"),
    ):
        with pytest.raises(BundleError, match=said):
            _ = drawn(tmp_path, outline=outline, points={}).drawing
    for text, said in (("x,z\n0,0\n", "columns x and y are wanted"), ("x,y\n0,0\n1,0\n", "three points or more")):
        (tmp_path / "o.csv").write_text(text)
        with pytest.raises(BundleError, match=said):
            _ = drawn(tmp_path, outline={"table": "o.csv"}).drawing


def gong(**values: Any) -> Any:
    usual = {
        "sides": [0.41, 0.3],
        "thickness": 1e-3,
        "young": 110e9,
        "poisson": 0.3,
        "density": 8700.0,
        "sigma0": 0.5,
        "sigma2": 1e-7,
        "freq_coupled": 400.0,
        "line": [[0.0, 0.2], [1.0, 0.8]],
    }
    return plugin("gong").from_values(usual | values)


def test_a_gong_s_modes_and_shapes_are_those_of_a_hinged_plate() -> None:
    """omega = sqrt(D / rho h) pi^2 (m^2/a^2 + n^2/b^2); shapes 2 / sqrt(rho h a b) sin sin on the line of places."""
    made = gong()
    D, m = 110e9 * 1e-9 / (12 * (1 - 0.09)), 8.7
    speed = math.sqrt(D / m)
    wanted = sorted(
        (speed * math.pi**2 * (i * i / 0.1681 + j * j / 0.09), i, j) for i in range(1, 30) for j in range(1, 30)
    )
    basis = made.basis(1000.0)
    below = [row for row in wanted if row[0] < 2 * math.pi * 1000.0]
    assert np.sqrt(basis.stiffness) == pytest.approx([w for w, _, _ in below])
    assert basis.damping_rate == pytest.approx([0.5 + 1e-7 * w * w for w, _, _ in below])
    assert made.length == pytest.approx(math.hypot(0.41, 0.18))
    assert (made.start.tolist(), made.end.tolist()) == ([0.0, pytest.approx(0.06)], [0.41, pytest.approx(0.24)])
    place = 0.3 * made.length
    x, y = 0.3 * 0.41, 0.06 + 0.3 * 0.18
    shapes = [
        2 / math.sqrt(m * 0.123) * math.sin(i * math.pi * x / 0.41) * math.sin(j * math.pi * y / 0.3)
        for _, i, j in below
    ]
    assert basis.shape(place) == pytest.approx(shapes, abs=1e-9)
    assert not basis.shape(0.0).any()
    lowest = speed * math.pi / 2 * (1 / 0.1681 + 1 / 0.09)
    assert made.tension / (2 * made.length * lowest) == pytest.approx(8 * math.sqrt(D * m))
    assert basis.metadata["coupled"] == sum(w < 2 * math.pi * 400.0 for w, _, _ in wanted)
    assert made.detuned(basis, 5.0) is basis
    for values, said in (
        ({"line": [[0.1, 0.2], [1.0, 0.8]]}, "begins on an edge"),
        ({"line": [[0.0, 0.2], [0.0, 0.2]]}, "two different ends"),
        ({"line": [[0.0, 1.2], [1.0, 0.8]]}, "from 0 to 1"),
        ({"sides": [0.019, 0.3]}, "0.02 to 5 m"),
    ):
        with pytest.raises(BundleError, match=said):
            gong(**values)
    with pytest.raises(BundleError, match="a gong has no stops"):
        made.basis(1000.0, stop=0.1)
    with pytest.raises(BundleError, match="is below the lowest mode"):
        gong(freq_coupled=20.0).basis(1000.0)


def test_the_ascent_ends_at_the_largest_ratio_that_random_motions_stay_below() -> None:
    made = gong()
    grid = made.grid(4)
    _, omega = made.plate.modes(400.0)
    K = stiffening(grid, omega[:4])
    rng, ratios = np.random.default_rng(1), []
    for _ in range(200):
        y = rng.normal(size=4) / omega[:4]
        ratios.append(grid.energy(y) / (0.5 * np.sum((omega[:4] * y) ** 2)) ** 2)
    assert max(ratios) <= K * (1 + 1e-9)
    assert 3 * max(ratios) > K
    energy = PlateEnergy(grid)
    assert energy.sizes == (4,)
    assert energy.gradient(y)[0] == pytest.approx(energy.energy(y))


def deflection(level_db: float = -80.0, cents: float = 0.5) -> LargeDeflection:
    """The switch of two gongs by themselves."""
    choice = SimpleNamespace(mode="auto", budget_db=level_db, budget_cents=cents, names={LARGE_DEFLECTION.name})
    strings = {name: SimpleNamespace(components=(f"{name}.z",)) for name in ("g", "h")}
    model: Any = SimpleNamespace(choice=choice, strings=strings)
    return LargeDeflection(model, LARGE_DEFLECTION, {"g": None, "h": None})  # type: ignore[dict-item]


def at(**more: Any) -> Any:
    return SimpleNamespace(fresh=[], busy=(), **more)


@pytest.mark.parametrize(
    ("cents", "level", "on", "more", "wanted"),
    [
        (0.5, 1e-4, (), {}, False),
        (0.51, 0.0, (), {}, True),
        (0.0, 1.01e-4, (), {}, True),
        (0.41, 0.0, ("g",), {}, True),
        (0.39, 0.0, ("g",), {}, False),
        (0.0, 0.81e-4, ("g",), {}, True),
        (0.0, 0.0, (), {"fresh": ["g"]}, True),
        (0.0, 0.0, ("g",), {"busy": ("g",)}, True),
        (0.0, 0.0, (), {"busy": ("g",)}, False),
    ],
)
def test_a_gong_is_switched_by_its_budgets(
    cents: float, level: float, on: tuple[str, ...], more: dict[str, Any], wanted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = deflection()
    monkeypatch.setattr(effect, "_bound", lambda moment, name: ta.Bound(cents, level) if name == "g" else ta.Bound())
    moment = at()
    moment.fresh = [SimpleNamespace(string=name) for name in more.get("fresh", ())]
    moment.busy = more.get("busy", ())
    found = effect.watch(moment, ta.Switching(frozenset(on)))
    assert found is not None
    assert ("g" in found.wanted) is wanted
    assert [(name, left) for name, _, left in found.bounds] == [("g", not wanted), ("h", True)]
    waits = ta.Switching(pending=frozenset({"g"}))
    assert (effect.next_watch(100, waits), effect.next_watch(100, ta.Switching())) == (128, 1024)


def test_the_energy_of_a_gong_and_of_its_mallet_raises_its_pitch() -> None:
    """1.5 K E of the frequency, 4 K E of the force: of all components that the gong owns."""
    effect = deflection()
    gong_modes = ModalBasis.real([100.0, 300.0], [1.0, 1.0], {"bridge": [1.0, 1.0]}, metadata={"stiffening": 0.02})
    mallet = ModalBasis.real([10.0], [1.0], {"mass": [1.0]})
    parts = {"g.z": gong_modes, "g.mallet": mallet, "h.z": gong_modes}
    motion = {name: np.zeros((2, basis.n_modes)) for name, basis in parts.items()}
    motion["g.z"][0], motion["g.mallet"][1] = [0.01, 0.002], [0.3]
    system = SimpleNamespace(
        names=list(parts),
        slot=list(parts).index,
        compiled=[SimpleNamespace(basis=b) for b in parts.values()],
        layout=SimpleNamespace(owners={"g.z": "g", "g.mallet": "g", "h.z": "h"}),
        modes_of=lambda state, name: motion[name],
    )
    energy = 0.0
    for name in ("g.z", "g.mallet"):
        per_q, first, second, *_ = parts[name].motion
        q, v = per_q * motion[name][0], first * motion[name][0] + second * motion[name][1]
        energy += 0.5 * float(np.sum(v * v) + np.sum(parts[name].stiffness * q * q))
    bound = effect._bound(at(system=system, state=None), "g")
    assert bound.cents == pytest.approx(1200 / math.log(2) * 1.5 * 0.02 * energy)
    assert bound.level == pytest.approx(4 * 0.02 * energy)
    assert effect._bound(at(system=system, state=None), "h").cents == 0.0


def uncompiled() -> ModuleType:
    """The module of the gong's C function with a Numba that compiles nothing and takes arrays for addresses."""
    found = find_spec("tonewood.plugins._gong_energy_numba")
    assert found is not None
    assert found.loader is not None
    module = module_from_spec(found)
    numba = MagicMock()
    numba.njit = numba.cfunc = lambda *_, cache: lambda function: function
    numba.carray = lambda array, n, dtype=None: array[:n]
    with patch.dict(sys.modules, {"numba": numba}):
        found.loader.exec_module(module)
    return module


@pytest.mark.parametrize("edges", ["sliding", "movable"])
@pytest.mark.parametrize("n", [1, 2, 7, 12])
def test_the_compiled_potential_step_by_step(edges: str, n: int) -> None:
    """The functions that Numba compiles, as Python runs them; nothing is written where no gradient is asked for."""
    made = uncompiled()
    one = gong(edges=edges)
    grid, omega = one.grid(n), np.sqrt(one.basis(3000.0).stiffness[:n])
    y = np.random.default_rng(3).normal(size=n) / omega
    slope, scratch = np.full(n, np.nan), np.full(grid.scratch, np.nan)
    value = made.potential(grid.packed, n, y, slope, scratch)
    expected, expected_slope = grid.gradient(y)
    assert value == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(slope, expected_slope, rtol=0, atol=1e-12 * np.abs(expected_slope).max())

    class Null:
        """Array at the address 0."""

        ctypes = SimpleNamespace(data=0)

        def __getitem__(self, index: object) -> Null:
            return self

    assert made.potential(grid.packed, n, y, Null(), scratch) == value
