"""The drawn guitars beside measured figures, and drawings that no body has."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sla

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import plugin
from tonewood.instrument.inspection.frequencies import mobility_bands
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.coupling.system import System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.passivity.basis import check_basis
from tonewood.physics.plate import body_modes
from tonewood.physics.plate.microphones import pressure
from tonewood.physics.plate.plate import cell_size
from tonewood.physics.plate.tracking import followed
from tonewood.physics.stepping.motion import from_motion
from tonewood.physics.stepping.stepper import NumpyStepper

SMALL: dict[str, Any] = {
    "outline": {"points": [[0, 0], [0.3, 0], [0.3, 0.2], [0, 0.2]]},
    "wood": {"species": "sitka_spruce"},
    "thickness": 3e-3,
    "fmax": 1200.0,
    "cell": 0.03,
    "points": {"middle": {"at": [0.15, 0.1]}, "aside": {"at": [0.22, 0.06]}},
}


def small(**values: Any) -> Any:
    return plugin("drawn_body", "body").from_values(SMALL | values, None, "body")


@cache
def guitar(name: str = "drawn_guitar") -> tw.Instrument:
    return tw.load_instrument(name)


def levels(name: str, edges: np.ndarray) -> np.ndarray:
    """Bands of the mobility of a guitar at the ends of its strings, dB."""
    body = assemble(guitar(name), 48000).body
    ends = ("saddle_E2", "saddle_A2", "saddle_D3", "saddle_G3", "saddle_B3", "saddle_E4")
    points = [p if p in body.points else p.replace("saddle", "bridge") for p in ends]
    return mobility_bands(body, points, edges)


@pytest.mark.slow
def test_the_bridge_moves_as_a_measured_guitars() -> None:
    """Nothing is fitted: octaves of |Y| from 150 Hz to 4.8 kHz within 4 dB of the classical guitar's, 2 dB in all."""
    octaves = 150.0 * 2.0 ** np.arange(6)
    apart = levels("drawn_guitar", octaves) - levels("classical_guitar", octaves)
    assert np.abs(apart).max() < 4.0
    assert abs(np.mean(apart)) < 2.0


@pytest.mark.slow
def test_first_modes_are_those_of_guitars() -> None:
    """Classical guitars: A0 90-120, T1 170-250, T2 240-300 Hz, Q of T1 about 26 (Christensen & Vistisen 1980)."""
    modes = guitar().body.modes_below(2e4)
    named = modes.named()
    assert 90 < modes.freq[named["A0"]] < 120
    assert 170 < modes.freq[named["T1"]] < 250
    assert 240 < modes.freq[named["T1"] + 1] < 300
    assert 18 < 1 / modes.loss[named["T1"]] < 35
    assert modes.labels()[:2] == ("A0", "T1")
    assert modes.radiation_loss.min() >= 0
    assert modes.kinetic.sum(axis=0) == pytest.approx(np.ones(len(modes.freq)), abs=1e-9)


@pytest.mark.slow
def test_modes_are_as_dense_as_a_plates() -> None:
    """Without braces, air and shear, within 15 % of S/2 sqrt(rho h / sqrt(D_L D_R)) per Hz, between two edges."""
    rigid = {"wood": {"species": "sitka_spruce", "G_LT": 1e12, "G_RT": 1e12}, "fmax": 5000.0, "cell": 0.015}
    counts = [small(edge={"kind": kind}, **rigid).basis(2e4).n_modes for kind in ("free", "clamped")]
    rigidity = np.sqrt(13.0e9 * 0.9e9) / (1 - 0.372**2 * 0.9 / 13.0) * 3e-3**3 / 12
    expected = 0.06 / 2 * np.sqrt(440 * 3e-3 / rigidity)
    assert np.mean(counts) / 5000.0 == pytest.approx(expected, rel=0.15)


def test_a_body_is_passive_and_symmetric() -> None:
    body = guitar().body
    basis = body.basis(2e4)
    assert basis.is_real
    assert sla.eigvalsh(basis.residual).min() >= -1e-12 * np.abs(basis.residual).max()
    check_basis(basis, list(body.points()), dt=1 / 48000).require()
    f = np.array([97.0, 440.0, 3000.0])
    assert basis.frf(f, "saddle_E2", "lower_bout") == pytest.approx(basis.frf(f, "lower_bout", "saddle_E2"))


def test_modes_left_out_go_into_the_residual() -> None:
    """The static compliance stays, however many modes are stepped."""
    body = guitar().body
    whole, part = body.basis(2e4).static_compliance(), body.basis(900.0).static_compliance()
    assert part == pytest.approx(whole, rel=1e-9, abs=1e-9 * np.abs(whole).max())


def test_static_compliance_does_not_depend_on_fmax() -> None:
    """Plate modes above it yield to the air of a closed box, and move the points, by their static compliance."""
    box = {"air": {"depth": 0.02}, "soundhole": None}
    few, many = (small(fmax=fmax, **box) for fmax in (700.0, 3000.0))
    alone = small(fmax=3000.0).basis(2e4).static_compliance()
    assert few.basis(2e4).n_modes < many.basis(2e4).n_modes // 3
    expected = many.basis(2e4).static_compliance()
    assert few.basis(2e4).static_compliance() == pytest.approx(expected, rel=1e-4)
    assert expected[0, 0] < 0.8 * alone[0, 0]  # the air is as stiff as the plate
    lowest = [body.modes_below(2e4).freq[0] for body in (few, many)]
    assert lowest[0] == pytest.approx(lowest[1], rel=1e-3)


@pytest.mark.slow
def test_modes_above_fmax_are_stated() -> None:
    """With their share of the static compliance at the first point: w = F sum phi^2 / omega^2 over the others."""
    few, many = small(fmax=500.0), small(fmax=8000.0, cell=0.02)
    (line,) = [line for line in few.facts() if "not stepped" in line]
    share = float(line.split("kept, ")[1].split(" %")[0]) / 100
    basis = many.basis(2e4)
    terms = basis.right.real[0] ** 2 / basis.stiffness
    assert line.startswith("modes above 500 Hz are not stepped")
    assert share == pytest.approx(terms[basis.natural_freq > 500.0].sum() / terms.sum(), rel=0.1)


def test_the_bridge_rocks() -> None:
    """A point h above the middle of the top moves by -h times the slope: twice the height, twice the shape."""
    points = {f"at_{h}": {"at": [0.2, 0.05], "direction": "y", "height": h} for h in (0.01, 0.02)}
    d = 1e-4
    beside = {f"z_{k}": {"at": [0.2, 0.05 + k * d]} for k in (-1, 1)}
    basis = small(points=points | beside).basis(2e4)
    low, high, before, after = basis.right.real
    assert high == pytest.approx(2 * low, rel=1e-12)
    assert low == pytest.approx(-0.01 * (after - before) / (2 * d), rel=1e-3, abs=1e-3 * np.abs(low).max())


def test_an_svg_path_is_an_outline(tmp_path: Path) -> None:
    """The same rectangle as a path in mm; y runs downwards there."""
    (tmp_path / "top.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><path id="hole" d="M0 0 L1 1 L2 0z"/>'
        '<path id="outline" d="M 0,0 H 300 V -200 H 0 Z"/></svg>'
    )
    files = Files(tmp_path, tmp_path / "instrument.yaml")
    values = SMALL | {"outline": {"svg": {"file": "top.svg", "id": "outline"}}}
    drawn = plugin("drawn_body").from_values(values, files, "body")
    assert drawn.basis(2e4).natural_freq == pytest.approx(small().basis(2e4).natural_freq, rel=1e-12)
    values = SMALL | {"outline": {"svg": {"file": "top.svg", "id": "other"}}}
    with pytest.raises(BundleError, match="there is no path 'other'; there are hole, outline"):
        plugin("drawn_body").from_values(values, files, "body").basis(2e4)


@pytest.mark.slow
def test_a_thickness_map(tmp_path: Path) -> None:
    """A uniform map is a uniform thickness; of a wedge the modes lie between those of its ends."""
    rows = [f"{x},{y}," for x in (0.0, 0.3) for y in (0.0, 0.2)]
    for name, heights in (("even", [3e-3] * 4), ("wedge", [2e-3, 2e-3, 4e-3, 4e-3])):
        lines = [row + str(h) for row, h in zip(rows, heights, strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["x,y,h", *lines]))
    files = Files(tmp_path, tmp_path / "instrument.yaml")
    even, wedge = (
        plugin("drawn_body").from_values(SMALL | {"thickness": {"table": f"{name}.csv"}}, files, "body").basis(2e4)
        for name in ("even", "wedge")
    )
    assert even.natural_freq == pytest.approx(small().basis(2e4).natural_freq, rel=1e-9)
    thin, thick = (small(thickness=h).basis(2e4).natural_freq for h in (2e-3, 4e-3))
    assert np.all((thin[:4] < wedge.natural_freq[:4]) & (wedge.natural_freq[:4] < thick[:4]))


@pytest.mark.slow
def test_a_live_back_lowers_the_first_modes() -> None:
    """Another spring yields behind the air: A0 and T1 of a body with a back lie below those with a rigid one."""
    values = {"soundhole": {"centre": [0.07, 0.1], "radius": 0.03}, "air": {"depth": 0.08}}
    rigid = small(**values).modes_below(2e4)
    live = small(**values, back={"wood": {"species": "maple"}, "thickness": 2.5e-3}).modes_below(2e4)
    assert live.freq[0] < rigid.freq[0]
    assert len(live.freq) > len(rigid.freq)


BAD = [
    ({"thickness": 0.0}, "thickness is 0 m; 0.0001 to 0.1 m are allowed"),
    ({"outline": {"points": [[0, 0], [0.3, 0.2], [0.3, 0], [0, 0.2]]}}, "crosses itself at x 150.0 mm, y 100.0 mm"),
    ({"braces": {"b": {"start": [0.1, 0], "stop": [0.1, 0.3], "width": 0.01, "height": 0.1}}}, "body.braces.b: x 100"),
    ({"soundhole": {"centre": [0.02, 0.1], "radius": 0.03}}, "body.soundhole: the hole about x 20.0 mm"),
    (
        {
            "soundhole": {"centre": [0.1, 0.1], "radius": 0.03},
            "bridge": {"start": [0.1, 0.05], "stop": [0.1, 0.15], "width": 0.02, "height": 0.01},
        },
        "body.bridge: x 100.0 mm, y 7.* mm is in the soundhole",
    ),
    ({"wood": {"species": "sitka_spruce", "E_R": 200e9, "nu_LR": 0.9}}, "E_R nu_LR"),
    ({"wood": {"E_L": 1e10}}, "a species, or E_R too, is wanted"),
    ({"points": {"p": {"at": [0.4, 0.1]}}}, "body.points.p.at: x 400.0 mm, y 100.0 mm is not on the top"),
    ({"fmax": 2e4, "cell": 1e-3}, "a lower fmax or a larger cell is wanted"),
    ({"back": {"wood": {"species": "maple"}, "thickness": 2e-3}}, "a back needs air"),
]  # fmt: skip


@pytest.mark.parametrize(("values", "reason"), BAD, ids=[reason[:20] for _, reason in BAD])
def test_bad_drawings_are_refused_with_the_place(values: dict[str, Any], reason: str) -> None:
    with pytest.raises(BundleError, match=reason):
        small(**values).basis(2e4)


def test_the_cache_has_arrays_of_each_blas_library_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another processor kernel rounds otherwise: arrays computed with it would change a render's last bits."""
    from tonewood.instrument.contract import array_cache

    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path))
    for number, kernel in enumerate(("Haswell", "SkylakeX", "Haswell")):
        monkeypatch.setattr(array_cache, "numpy_blas", lambda kernel=kernel: [f"openblas 0.3.30 {kernel}"])
        array_cache._RECENT.clear()
        array_cache._sources.cache_clear()
        found = array_cache.cached_arrays({"a": 1}, lambda n=number: {"x": np.array(n)})["x"]
        assert found == number % 2
    array_cache._sources.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize(("channel", "at"), [("left", (0.3, -0.3, 1.0)), ("right", (0.3, 0.3, 1.0))])
def test_microphones_follow_the_rayleigh_sum(channel: str, at: tuple[float, float, float]) -> None:
    """Every driven point of the guitar, each in its own direction: 95 % of 50 Hz to 6 kHz within 0.2 dB."""
    model = assemble(guitar(), 48000, outputs=["microphones"])
    bank = model.system.compiled[model.system.slot("microphones")].basis
    body, sources = guitar().body.basis(2e4), guitar().body.sources(2e4)
    f = np.geomspace(50.0, 6000.0, 1500)
    delay = sources.distances(at).min() / 343.0
    shapes = np.array([body.right.real[body.index(p)] for p in body.points])
    exact = pressure(sources, at, body.poles, shapes, f, delay).T
    found = np.array([bank.frf(f, channel, f"at_{p}", "receptance") for p in body.points])
    heard = np.abs(exact) > 1e-2 * np.sqrt(np.mean(np.abs(exact) ** 2, axis=0))
    error = np.abs(20 * np.log10(np.abs(found[heard] / exact[heard])))
    assert np.median(error) < 0.02
    assert np.percentile(error, 95) < 0.2


@pytest.mark.slow
def test_delays_between_microphones_are_kept() -> None:
    """One at 0.5 m and one 0.6 m behind it: the sums with the nearer one's delay taken out of both, within 0.2 dB."""
    far = guitar().replace({"outputs.microphones.at": {"near": [0.3, 0, 0.5], "far": [0.3, 0.1, 1.1]}})
    model = assemble(far, 48000, outputs=["microphones"])
    bank = model.system.compiled[model.system.slot("microphones")].basis
    body, sources = far.body.basis(2e4), far.body.sources(2e4)
    f = np.geomspace(60.0, 5500.0, 800)
    shapes = body.right.real[[body.index("saddle_D3")]]
    exact = pressure(sources, (0.3, 0.1, 1.1), body.poles, shapes, f, sources.distances((0.3, 0, 0.5)).min() / 343)[
        :, 0
    ]
    found = bank.frf(f, "far", "at_saddle_D3", "receptance")
    error = 20 * np.log10(1 + np.abs(found - exact) / np.maximum(np.abs(exact), 1e-2 * np.abs(exact).max()))
    assert np.percentile(error, 95) < 0.2


def test_a_tapped_guitar_is_heard() -> None:
    """Level of a tap of 5 N for 1 ms, a thousandth of a newton second: some 0.3 Pa at 1 m."""
    score = tw.Score([tw.Note(0.0, 0.1, technique="tap", force=5.0, string="E2", stop=0)])
    audio = tw.render(score, guitar(), 48000, max_duration=0.5)
    peak = np.abs(audio.samples).max() * 4.0
    assert 0.03 < peak < 3.0


@pytest.mark.slow
def test_sound_has_its_own_entry_in_the_account_of_energy() -> None:
    """Modes that ring freely radiate sum_k int R_k v_k^2 dt, R_k of the Rayleigh sums; the account closes."""
    body = small(fmax=800.0, baffle="infinite")
    basis, sources = body.basis(2e4), body.sources(2e4)
    assert sources is not None
    system = System.build({"body": basis}, [], [], dt=1 / 24000)
    stepper, state = NumpyStepper(system), system.start()
    q = np.linspace(1.0, 2.0, basis.n_modes) * 1e-6
    system.modes_of(state, "body")[:] = from_motion(basis, q, np.zeros(basis.n_modes))
    account = EnergyAccount(system, state.copy(), interval=64)
    for _ in range(20):
        before = state.copy()
        _, forces = stepper.run(state, 480)
        account.follow(before, state, forces)
    trace = account.trace()
    assert np.abs(trace.residual).max() < 1e-12 * trace.initial["body"]
    sigma, omega = basis.damping_rate, np.sqrt(basis.stiffness)
    left = np.exp(-2 * sigma * 0.4)  # of each mode's energy but for 2 sigma / omega
    expected = sources.resistance(basis.natural_freq) @ (0.5 * (omega * q) ** 2 * (1 - left) / (2 * sigma))
    assert trace.lost["body.sound"].sum() == pytest.approx(expected, rel=5e-3)
    assert 0 < expected < 0.5 * trace.lost["body"].sum()


@pytest.mark.slow
def test_a_tapped_guitars_account_has_its_sound() -> None:
    coarse = guitar().replace({"body.fmax": 400.0, "body.cell": 0.04})
    score = tw.Score([tw.Note(0.0, 0.05, technique="tap", force=5.0, string="E2", stop=0)])
    trace = tw.render(score, coarse, 48000, max_duration=0.06, energy=True, outputs=("bridge",), effects="none").energy
    assert trace is not None
    assert trace.lost["body.sound"].min() >= -1e-15
    supplied = sum(values.sum() for values in trace.supplied.values())
    assert 0.1 < trace.lost["body.sound"].sum() / trace.lost["body"].sum() < 2.0
    assert np.abs(trace.residual).max() < 1e-9 * supplied


def test_microphones_need_a_body_that_says_how_it_moves() -> None:
    values = {"outputs.microphones": {"name": "microphones", "plugin": "body_microphones", "at": {"a": [0, 0, 1]}}}
    with pytest.raises(BundleError, match="hears bodies that say how their whole surface moves"):
        assemble(guitar("classical_guitar").replace(values | {"outputs.microphones.full_scale": 1.0}), 48000)


def test_a_measured_body_with_shapes_on_a_grid_is_heard(tmp_path: Path) -> None:
    """A table of the drawn body's own modes at a grid of its squares gives nearly the same pressure at 1 m."""
    drawn = guitar().body
    modes = drawn.modes_below(1200.0)
    n = int(modes.hole_from[0])
    step, few = modes.volumes[:n] / modes.areas[:n, None], range(0, n, 7)
    names = [f"p{i}" for i in few]
    head = ",".join(["f_Hz", "Q", "saddle", *names])
    saddle = modes.shapes[list(drawn.points()).index("saddle_G3")]
    rows = [
        ",".join(f"{x:.12g}" for x in (f, 1 / loss, s, *step[list(few), k]))
        for k, (f, loss, s) in enumerate(zip(modes.freq, modes.loss, saddle, strict=True))
    ]
    (tmp_path / "grid.csv").write_text("\n".join([head, *rows]))
    share = modes.areas[:n].sum() / modes.areas[list(few)].sum()
    points: dict[str, Any] = {"saddle": {}}
    for i, name in zip(few, names, strict=True):
        place, area = modes.sources[i].tolist(), float(modes.areas[i] * share)
        points[name] = {"place": place, "area": area, "driven": False}
    values = {"table": "grid.csv", "shapes": "points", "points": points}
    table = plugin("modal_table").from_values(values, Files(tmp_path, tmp_path / "instrument.yaml"), "body")
    found = table.sources(2e4)
    assert found is not None
    assert found.volumes.shape == (len(names), len(modes.freq))
    at, f = (0.3, 0.0, 1.0), np.array([80.0, 400.0])
    exact = type(found)(modes.sources[:n], modes.volumes[:n], baffled=False).pressure(at, f)[:2]
    assert np.abs(found.pressure(at, f)[:2]) == pytest.approx(np.abs(exact), rel=0.1)
    assert guitar("classical_guitar").body.sources(2e4) is None


def test_its_modes_can_be_written_as_a_table(tmp_path: Path) -> None:
    """`modal_table` makes the same body of the table and of the keys in its first lines."""
    from tonewood.instrument.inspection.modal_export import modal_table_text
    from tonewood.support.yaml_io import parse_yaml

    body = guitar().body
    text = modal_table_text(body, "body.csv", 2e4)
    (tmp_path / "body.csv").write_text(text)
    keys = "\n".join(line[2:] for line in text.splitlines() if line.startswith("# "))
    values = dict(parse_yaml(keys)["body"])
    del values["plugin"]
    table = plugin("modal_table").from_values(values, Files(tmp_path, tmp_path / "instrument.yaml"), "body")
    f = np.array([110.0, 440.0, 5000.0, 9000.0])
    for a, b in (("saddle_E2", "saddle_E2"), ("saddle_B3_y", "lower_bout")):
        assert table.basis(2e4).frf(f, a, b) == pytest.approx(body.basis(2e4).frf(f, a, b), rel=1e-6)
    assert table.points()["saddle_E2_y"].direction == (0.0, 1.0, 0.0)


@pytest.mark.validate
@pytest.mark.parametrize(("name", "median", "worst"), [("drawn_guitar", 0.006, 0.011), ("drawn_guitar_x", 0.011, 0.02)])
def test_default_cells_of_a_braced_top_are_off_by_what_the_guide_says(name: str, median: float, worst: float) -> None:
    """First 100 modes beside cells of 7.5 and 5.5 mm: too high by what the guide states, by half of it with 7.5 mm."""
    drawing = guitar(name).body.drawing
    size = cell_size(drawing.top.wood, drawing.top.thickness, 6000.0)
    coarse, middle, fine = (
        body_modes(replace(drawing, fmax=5000.0, top=replace(drawing.top, size=s))).freq[:100]
        for s in (size, 7.5e-3, 5.5e-3)
    )
    apart = coarse / fine - 1
    assert apart.min() > 0
    assert np.median(apart) < median
    assert apart.max() < worst
    assert np.median(middle / fine - 1) < np.median(apart) / 2


@pytest.mark.validate
def test_the_lower_bar_moves_modes_smoothly() -> None:
    """In steps of 1 mm over a cell: each of 14 modes within 0.2 cent of a curve of degree 5, T1 of a cubic as well."""
    places = np.arange(0.207, 0.2201, 0.001)
    steps = []
    for x in places:
        moved = {f"body.braces.bar_low.{end}.0": float(x) for end in ("start", "stop")}
        drawing = guitar().replace(moved).body.drawing
        steps.append(body_modes(replace(drawing, fmax=1200.0, top=replace(drawing.top, size=0.012))))
    cents = 1200 * np.log2(followed(steps, 14) / steps[0].freq[:14])
    t = (places - places.mean()) / np.ptp(places)
    assert np.ptp(cents[:, 1]) > 20.0
    assert np.abs(cents[:, 1] - np.polyval(np.polyfit(t, cents[:, 1], 3), t)).max() < 0.2
    for c in cents.T:
        assert np.abs(c - np.polyval(np.polyfit(t, c, 5), t)).max() < 0.2


@pytest.mark.validate
def test_thirds_of_an_octave_lie_within_the_spread_of_guitars() -> None:
    """At most 12 dB from the measured classical guitar, as far as another measured guitar is from it."""
    thirds = 150.0 * 2.0 ** (np.arange(16) / 3)
    apart = levels("drawn_guitar", thirds) - levels("classical_guitar", thirds)
    assert np.abs(apart).max() < 12.0
