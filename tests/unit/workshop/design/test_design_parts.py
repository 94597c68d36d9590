"""Parts of a design by themselves: figures of resonances, the search on figures of closed form, words, bodies."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from test_design import BOX

from tonewood.errors import BundleError, OutputError, TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.plate.whole_body import LowModes, WholeBody
from tonewood.workshop.design import bodies, search, sensitivity, words
from tonewood.workshop.design.figures import DrawnResonances, StringEnd, figures, worst_wolf
from tonewood.workshop.design.folder import _yaml, write_changed
from tonewood.workshop.design.search import FoundDesign, _Named, _Search, _value
from tonewood.workshop.design.task import Free, Target, _leaves, _pitch, _under, parse_free, parse_targets

SMALL = {
    **BOX,
    "body": {key: value for key, value in BOX["body"].items() if key not in ("soundhole", "air", "braces")}
    | {"fmax": 300.0, "cell": 0.06},
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A plate without air on large cells."""
    folder = tmp_path_factory.mktemp("small") / "box"
    folder.mkdir()
    (folder / "instrument.yaml").write_text(yaml.safe_dump(SMALL))
    return Instrument.load(folder)


def target(text="mode 1 = 200", kind="freq", sense="=", value=200.0, **more):
    return Target(text, kind, sense, value, **{"mode": "1"} | more)


def free(name="p", low=0.0, high=10.0, base=4.0, kind=""):
    return Free(name, (name,), (base,), kind, low, high)


# figures


def low_modes(freq=(0.5, 100.0, 200.0, 300.0, 400.0), named=None):
    n = len(freq)
    shapes = np.arange(1.0, 2 * n + 1).reshape(2, n) / 10
    return LowModes(np.array(freq), np.full(n, 0.02), shapes, np.array([[1e-7, 0.0], [0.0, 3e-7]]), 0.15, named or {})


def test_resonances_of_a_drawn_body() -> None:
    found = DrawnResonances(low_modes())
    assert found.quality.tolist() == [50.0] * 5
    assert found.squares == pytest.approx(found.modes.shapes**2)
    freq = np.array([90.0, 250.0])
    w, own = 2 * np.pi * freq, 2 * np.pi * found.freq
    for k in range(2):
        total = sum(found.modes.shapes[1, i] ** 2 / (own[i] ** 2 - w[k] ** 2 + 0.02j * w[k] * own[i]) for i in range(5))
        assert found.mobility(1, freq)[k] == pytest.approx(1j * w[k] * (total + 3e-7))


def test_figures_are_those_of_their_kind() -> None:
    found = DrawnResonances(low_modes(named={"A0": 1, "T1": 3}))
    rows = [
        target(mode="1"),
        target(mode="4"),
        target(mode="T1"),
        target(kind="mass"),
        target(kind="mobility", at="b", band=(80.0, 500.0)),
    ]
    freq = np.geomspace(80, 500, 400)
    mean = np.mean(20 * np.log10(np.abs(found.mobility(1, freq))))
    # 0.5 Hz is rigid: below a hundredth of the fourth
    assert figures(rows, found, ["a", "b"], []) == pytest.approx([100.0, 400.0, 300.0, 0.15, mean])
    slow = DrawnResonances(low_modes((3.1, 100.0, 200.0, 300.0)))
    assert figures([target()], slow, ["a", "b"], []).tolist() == [3.1]
    with pytest.raises(TonewoodError, match="of 4 modes looked at, A0, T1"):
        figures([target(mode="5")], found, ["a", "b"], [])
    with pytest.raises(TonewoodError, match="of 4 modes looked at, none has a name"):
        figures([target(mode="A0")], slow, ["a", "b"], [])
    unknown = SimpleNamespace(mass=None)
    with pytest.raises(TonewoodError, match="the mass of a measured body is not known"):
        figures([target(kind="mass")], unknown, [], [])
    named = _Named(found, {"A0": 2})
    assert figures([target(mode="A0"), target(mode="1")], named, ["a", "b"], []).tolist() == [200.0, 100.0]
    assert (named.mass, named.quality.tolist()) == (0.15, [50.0] * 5)


def test_wolves_lie_within_the_reach_of_strings() -> None:
    """Half a semitone beyond a string's ends; the worst of strings and modes; -1200 where none comes near."""
    end = StringEnd("D3", 1, 0.6, 147.0, 220.0)

    def one(freq, q=1e5, square=5.0):
        return SimpleNamespace(
            freq=np.array(freq), quality=np.full(len(freq), q), squares=np.full((2, len(freq)), square)
        )

    wide = (20.0, 2000.0)
    assert worst_wolf(one([180.0]), [end], wide) == pytest.approx(1200 * math.log2(220 * 2 ** (1 / 24) / 180.0))
    assert worst_wolf(one([150.0]), [end], wide) == pytest.approx(1200 * math.log2(150 / 147) + 50)
    assert worst_wolf(one([140.0]), [end], wide) == pytest.approx(1200 * math.log2(140 / 147) + 50)
    assert worst_wolf(one([70.0, 500.0]), [end], wide) == -1200.0
    assert worst_wolf(one([180.0]), [end], (300.0, 400.0)) == -1200.0
    assert worst_wolf(one([180.0]), [], wide) == -1200.0
    quiet = one([180.0], 20.0, 0.5)
    strong = 2 * 20 / np.pi * np.sqrt(2 * 0.6 / 180.0 * 0.5)
    assert worst_wolf(quiet, [end], wide) == pytest.approx(1200 * math.log2(strong))
    assert worst_wolf(one([150.0, 180.0]), [end, replace(end, low=100.0)], wide) == pytest.approx(
        1200 * math.log2(220 * 2 ** (1 / 24) / 150.0)
    )


# the task


def test_leaves_and_patterns_of_a_body() -> None:
    tree = {"a": 1, "b": [2.5, {"c": 3}], "d": True, "e": None, "f": "word", "g": (4,)}
    assert list(_leaves(tree, "body")) == [("body.a", 1.0), ("body.b.0", 2.5), ("body.b.1.c", 3.0), ("body.g.0", 4.0)]
    for pattern, under in (
        ("body", True),
        ("body.b", True),
        ("body.*.0", True),
        ("body.b.0.x", False),
        ("body.c", False),
    ):
        assert _under("body.b.0", pattern) is under
    assert _pitch("A3", "") == 220.0
    assert _pitch("98.5", "") == 98.5
    with pytest.raises(TonewoodError, match="'no wolf H3'"):
        _pitch("H3", "no wolf H3")


# the search


class Bowl:
    """Figures that are linear in the parameters: 200 + 3 a - b Hz, 0.1 + 0.01 a kg."""

    def __init__(self, bend=0.0):
        self.bend, self.asked = bend, 0

    def at(self, values):
        self.asked += 1
        self.values = np.array(values)
        return self.near(values)

    def near(self, values):
        a, b = values
        return SimpleNamespace(freq=np.array([200.0 + 3 * a - b + self.bend * a**2]), mass=0.1 + 0.01 * a, named={})

    def beside(self, i):
        step = 1e-6
        less, more = (self.near(self.values + by * np.eye(2)[i]) for by in (-step, step))
        return less, more, step


def searching(targets, *, low=(0.0, 0.0), high=(10.0, 10.0), start=(4.0, 4.0), bend=0.0, tell=lambda line: None):
    out = _Search.__new__(_Search)
    out._tell, out._steps, out.targets = tell, 0, tuple(targets)
    out.free = tuple(free(name, lo, hi, at) for name, lo, hi, at in zip("ab", low, high, start, strict=True))
    out.points, out.ends, out.body = [], [], Bowl(bend)
    out.start, out.low, out.high = np.array(start), np.array(low), np.array(high)
    out.shift, out._at, out._rates = np.zeros(len(targets)), None, None
    return out


def test_a_search_ends_at_the_least_change_that_reaches_its_target() -> None:
    """Of all (a, b) with 3 a - b = 20 the one nearest to (4, 4): (5.2, 3.6) but for the weight of changes."""
    told = []
    found = searching([target(value=212.0)], tell=told.append)
    values = found.run(np.array([4.0, 4.0]))
    assert values == pytest.approx([5.2, 3.6], abs=0.02)
    assert told[0] == f"step 1: mode 1 = 200 off by {1200 * math.log2(208 / 212):+.3g} cents"
    assert found.figures_at(values) == pytest.approx([212.0], rel=1e-4)
    assert found.rates(values) == pytest.approx(np.array([[3.0, -1.0]]), rel=1e-5)
    bounded = searching([target(value=260.0)]).run(np.array([4.0, 4.0]))
    assert bounded.tolist() == [10.0, 0.0]
    still = searching([target(value=190.0, sense=">=")])
    assert still.run(np.array([4.0, 4.0])) == pytest.approx([4.0, 4.0], abs=1e-6)
    curved = searching([target(value=260.0)], bend=1.0)
    end = curved.run(np.array([4.0, 4.0]))
    assert curved.figures_at(end) == pytest.approx([260.0], rel=1e-3)


def test_errors_are_weighted_and_changes_count_little() -> None:
    found = searching([target(value=212.0), target(kind="mass", value=0.1, sense="<=")])
    errors = found._errors(np.array([0.5, 0.1]), np.array([200.0, 0.12]))
    assert errors == pytest.approx([1200 * math.log2(200 / 212) / 17, 20.0, 0.02 * 0.1, -0.02 * 0.3])


def test_a_full_computation_moves_figures_by_a_factor_or_a_difference() -> None:
    rows = [target(value=212.0), target(kind="mass", value=0.1)]
    found = searching(rows)
    values = np.array([4.0, 4.0])
    found.correct(values, np.array([416.0, 0.07]))
    assert found.figures_at(values) == pytest.approx([416.0, 0.07])
    assert found.rates(values) == pytest.approx(np.array([[6.0, -2.0], [0.005, 0.0]]), rel=1e-4, abs=1e-9)
    assert found._relative.tolist() == [True, True]
    level = searching([target(kind="mobility", value=-30.0)])
    level._figures = lambda body: np.array([-40.0])
    level.correct(values, np.array([-37.0]))
    assert level.shift.tolist() == [3.0]
    assert level.figures_at(values).tolist() == [-37.0]
    assert level._relative.tolist() == [False]


def test_figures_are_computed_once_at_a_place() -> None:
    found = searching([target(value=212.0)])
    for _ in range(3):
        found.figures_at(np.array([1.0, 2.0]))
    assert found.body.asked == 1
    none = searching([target()])
    none.free = ()
    assert none.run(np.zeros(0)).size == 0


def test_values_of_parameters_in_an_instrument() -> None:
    tree = SimpleNamespace(resolved={"body": {"added": [{"mass": 0.006}]}})
    path = ("body.added.0.mass",)
    for kind, base, wanted in (("", 0.004, 0.006), ("x", 0.004, 1.5), ("+", 0.004, 0.002), ("x", 0.0, 1.0)):
        assert _value(Free("m", path, (base,), kind, 0.0, 1.0), tree) == pytest.approx(wanted)


# words


@pytest.fixture
def design() -> FoundDesign:
    targets = (
        target("A0 = 100", value=100.0, mode="A0"),
        target("mass <= 0.2", kind="mass", sense="<=", value=0.2),
        target("mobility b 80..800 >= -30", kind="mobility", sense=">=", value=-30.0, at="b"),
    )
    parameters = (free("h", 0.0, 1.0), free("w", 1.0, 3.0, 2.0, "x"), free("z", -1.0, 1.0, 0.0, "+"))
    rates = np.array([[10.0, -2.0, 0.0], [0.02, -0.004, 0.0], [0.0, 0.0, 5.0]])
    return FoundDesign(
        targets,
        parameters,
        np.array([0.5, 1.0, 0.0]),
        np.array([0.75, 3.0, 0.0005]),
        np.array([90.0, 0.19, -35.0]),
        np.array([101.0, 0.2008, -32.0]),
        rates,
        None,
    )


def test_costs_and_tolerances_of_a_design(design) -> None:
    off = [1200 * math.log2(1.01), 0.4, -2.0]
    assert design.off == pytest.approx(off)
    assert not design.ok
    missed, changes = design.cost
    assert missed == pytest.approx((off[0] / 17) ** 2 + 4.0)  # the mass is within half of a percent
    assert changes == pytest.approx(0.25**2 + 1.0 + (0.0005 / 2) ** 2)
    near = replace(design, reached=np.array([100.49, 0.201, -30.5]))
    assert near.ok
    assert near.cost[0] == 0
    assert not replace(near, reached=np.array([100.5, 0.201, -30.5])).ok


def test_words_of_a_design(design) -> None:
    text = list(words.lines(design))
    assert text[:4] == [
        "parameters: now, designed (bounds)",
        "  h: 0.5 to 0.75  (0 .. 1)",
        "  w: x 1 to x 3  (x 1 .. x 3)",
        "  z: + 0 to + 0.0005  (+ -1 .. + 1)",
    ]
    assert "  A0 = 100: 90.0 Hz to 101.0 Hz; MISSED by +17.2 cents" in text
    assert "  mass <= 0.2: 190.0 g to 200.8 g; reached within 0.4 %" in text
    assert "  mobility b 80..800 >= -30: -35.0 dB to -32.0 dB; MISSED by -2 dB" in text
    assert words.at_bounds(design) == ["w stands at its upper bound, x 3"]
    assert words.at_bounds(replace(design, values=np.array([0.0011, 1.0019, 0.9])))[0].startswith(
        "w stands at its lower"
    )
    per = 1200 / math.log(2) / 101.0
    assert words.effects(design) == pytest.approx(
        np.array(
            [[10 * per * 0.1, -2 * per * 0.2, 0.0], [0.02 * 500 * 0.1, -0.004 * 500 * 0.2, 0.0], [0.0, 0.0, 5.0 * 0.2]]
        )
    )
    assert words.trades(design) == ["A0 and mass rise and fall together, whichever of these is changed"]
    against = replace(design, rates=design.rates * [[1.0], [-1.0], [0.0]])
    assert words.trades(against) == [
        "A0 and mass go against one another, whichever of these is changed",
        "none of these parameters moves mobility at b here",
    ]
    assert words.trades(replace(design, free=(), rates=np.zeros((3, 0)))) == []
    assert [words._named(target(mode=m)) for m in ("3", "T1")] == ["mode 3", "T1"]
    assert words._named(target(kind="wolf")) == "the wolf"
    assert words.figure_words(target(kind="wolf"), 0.0) == "no wolf"
    assert words.figure_words(target(kind="wolf"), 12.4) == "a wolf, 12 cents too strong or too far inside"
    assert words.off_words(target(), 0.0) == "reached"
    assert words.off_words(target(), 8.5) == "reached within 8.5 cents"
    assert words.off_words(target(), -8.6) == "MISSED by -8.6 cents"


# bodies


def test_a_drawn_body_beside_its_parameters_is_the_body_computed_there(small) -> None:
    """Frequencies, masses and mobility to first order against central differences; lambda' of each mode."""
    lines = {"body.thickness": "2e-3 .. 3e-3"}
    parameters = parse_free(lines, small)
    body, freq = bodies.DrawnDesign(small, parameters, 200.0, mobility=True), np.geomspace(60.0, 250.0, 20)
    now = body.at([2.5e-3])
    assert body._below == pytest.approx(520.0)
    assert np.all(now.freq < 520.0)
    assert len(now.freq) == 5
    assert np.count_nonzero(small.body.modes_below(520.0).freq < 500.0) <= len(now.freq) + 1
    less, more, step = body.beside(0)
    assert step == pytest.approx(1e-8)
    rates = body.freq_rates(0)
    low, high = (bodies.DrawnDesign(small, parameters, 200.0, mobility=True).at([h]) for h in (2.499e-3, 2.501e-3))
    for name in ("freq", "squares"):
        wanted = (getattr(high, name) - getattr(low, name))[..., :4] / 2e-6
        told = (getattr(more, name) - getattr(less, name))[..., :4] / (2 * step)
        np.testing.assert_allclose(told, wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max())
    np.testing.assert_allclose(rates[:4], (high.freq - low.freq)[:4] / 2e-6, rtol=1e-3)
    wanted = (high.mobility(0, freq) - low.mobility(0, freq)) / 2e-6
    told = (more.mobility(0, freq) - less.mobility(0, freq)) / (2 * step)
    np.testing.assert_allclose(told, wanted, rtol=1e-2, atol=1e-2 * np.abs(wanted).max())
    assert (high.mass - low.mass) / 2e-6 == pytest.approx(now.mass / 2.5e-3, rel=1e-3)
    body.at([3e-3])  # at its bound the step lies inside
    assert body._sides(0)[0].size == body._whole.size
    assert isinstance(body._whole, WholeBody)
    assert body.beside(0)[1].freq[0] > now.freq[0]


def test_lumps_of_a_drawn_body_lie_at_their_points(small) -> None:
    added = [
        {"at": "bridge", "mass": 0.003, "stiffness": 2.0, "damping": 0.1},
        {"at": "bridge", "mass": 0.01, "frequency": 90.0, "q": 5.0},
    ]
    (lump,) = bodies.lumps(small.replace({"body.added": added}))
    assert (lump.mass, lump.stiffness, lump.damping) == (0.003, 2.0, 0.1)
    heavy = small.replace({"body.added": added[:1]})
    bare = bodies.DrawnDesign(small, parse_free({"body.thickness": "2e-3 .. 3e-3"}, small), 200.0, mobility=False)
    more = bodies.DrawnDesign(heavy, parse_free({"body.thickness": "2e-3 .. 3e-3"}, heavy), 200.0, mobility=False)
    a, b = bare.at([2.5e-3]), more.at([2.5e-3])
    assert b.mass == pytest.approx(a.mass + 0.003)
    assert b.freq[0] < a.freq[0]


def test_a_measured_body_changes_by_its_lumps_alone() -> None:
    guitar = Instrument.load("classical_guitar")
    number = Free("t", ("body.truncation.0",), (1.0,), "", 0.0, 2.0)
    with pytest.raises(TonewoodError, match="cannot change a measured body"):
        bodies.design_body(guitar, [number], 500.0, False)
    assert isinstance(bodies.design_body(guitar, [], 500.0, False), bodies.MeasuredDesign)
    found = bodies.MeasuredDesign(guitar, []).at([])
    assert found.mass is None
    assert found.named == {}
    assert np.all(np.diff(found.freq) >= 0)


def test_resonances_of_a_table_are_those_of_its_poles() -> None:
    table = bodies.TabledResonances(None, np.array([-3.0 + 40j]), np.array([[0.5j], [2.0]]), {})
    size = math.hypot(3, 40)
    assert table.freq == pytest.approx([size / 2 / np.pi])
    assert table.quality == pytest.approx([size / 6])
    assert table.squares == pytest.approx(np.array([[size], [4 * size]]))


# sensitivity and folder


def test_sensitivities_of_a_measured_body_are_differences() -> None:
    """Cents by a gram at the first, middle and last string's end, against a gram's hundredth put there."""
    guitar = Instrument.load("classical_guitar")
    found = sensitivity.sensitivity(guitar)
    points = [row.removeprefix("1 g at ") for row in found.rows]
    assert points == ["bridge_E2", "bridge_D3", "bridge_E4"]
    assert len(found.freq) == 8
    assert found.labels == tuple("12345678")
    assert found.remarks == ("the cents are first derivatives",)
    for point in points:
        heavy = guitar.replace({"body.added": [{"at": point, "mass": 1e-6}]})
        body = bodies.MeasuredDesign(heavy, parse_free({"body.added.0.mass": "1e-7 .. 1e-3"}, heavy))
        low, high = body.at([1e-6]).freq[:8], body.at([1.1e-5]).freq[:8]
        sums = np.eye(8)[[0, 1, 2, 3, 5, 6, 7]]
        sums[3, 4] = 1.0  # modes 4 and 5 coincide
        cents = 100 * 1200 * np.log2(high / low)
        np.testing.assert_allclose(sums @ found.rows[f"1 g at {point}"], sums @ cents, rtol=1e-3)
    text = sensitivity.words(found)
    assert len(text) == 5
    assert text[0].split()[:5] == ["cents", "of", "each", "mode", "1"]
    assert text[1].startswith(f"1 g at {points[0]}")
    assert [float(x) for x in text[1].split()[4:]] == pytest.approx(found.rows[f"1 g at {points[0]}"], abs=0.051)
    assert len({len(line) for line in text[:4]}) == 1


def test_dimensions_and_points_of_a_body() -> None:
    body = {
        "thickness": 2e-3,
        "braces": {"b": {}, "c": {}},
        "back": {"thickness": 3e-3, "braces": {"d": {}}},
        "bridge": {"height": 1},
    }
    keys = sensitivity._dimensions(SimpleNamespace(resolved={"body": body}))
    assert keys == [
        "body.thickness",
        "body.braces.b.height",
        "body.braces.c.height",
        "body.back.thickness",
        "body.back.braces.d.height",
        "body.bridge.height",
    ]
    assert sensitivity._dimensions(SimpleNamespace(resolved={"body": {"thickness": {"a": 1}}})) == []
    points = {name: SimpleNamespace(driven=name != "q") for name in "pqrst"}
    bare = SimpleNamespace(body=SimpleNamespace(points=lambda: points), spec=SimpleNamespace(strings={}))
    assert sensitivity._points(bare) == ["p", "r", "t"]
    strung = SimpleNamespace(
        body=bare.body,
        spec=SimpleNamespace(
            strings={
                1: SimpleNamespace(body_points=("s", "p")),
                2: SimpleNamespace(body_points=()),
                3: SimpleNamespace(body_points=("s",)),
            }
        ),
    )
    assert sensitivity._points(strung) == ["s"]


def test_a_changed_bundle_has_every_value_and_its_origin(small, tmp_path, monkeypatch) -> None:
    made = small.replace({"body.thickness": 2.7e-3})
    title = "t" * 250
    copy = write_changed(made, tmp_path / "copy", title, {"body.thickness": "n" * 400})
    assert copy.resolved["body"] == made.resolved["body"]
    assert (copy.name, copy.spec.title) == ("copy", title[:200])
    origin = yaml.safe_load((tmp_path / "copy" / "instrument.yaml").read_text())["provenance"]["body.thickness"]
    assert origin == {"kind": "authored", "note": "n" * 300}
    assert yaml.safe_load(_yaml({"a": {"b": [1, "ü"]}, "c": {}, "d": 2})) == {"a": {"b": [1, "ü"]}, "c": {}, "d": 2}
    with pytest.raises(OutputError, match="is there already"):
        write_changed(made, tmp_path / "copy", "", {})
    with pytest.raises(BundleError, match="cannot be the name"):
        write_changed(made, tmp_path / "1x", "", {})
    monkeypatch.setattr(Instrument, "load", lambda *args, **how: (_ for _ in ()).throw(OSError(28, "disk full")))
    with pytest.raises(OutputError, match="cannot be made: disk full"):
        write_changed(made, tmp_path / "other", "", {})
    assert not (tmp_path / "other").exists()


def test_slopes_of_targets() -> None:
    assert search.slope(target(kind="mass", value=0.5), 9.0) == 200.0
    assert search.slope(target(kind="wolf"), 9.0) == 1.0


def test_a_design_of_a_drawn_body_is_checked_by_two_full_computations(small) -> None:
    """A thinner plate has lower modes; what is said to be reached is the figure of the design that is returned."""
    told = []
    now = small.body.modes_below(math.inf).freq
    wanted = 0.95 * float(now[0])
    (row,) = parse_targets([f"mode 1 = {wanted:.4f}"], small)
    found = search.find_design(small, [row], parse_free({"body.thickness": "2e-3 .. 3e-3"}, small), told.append)
    assert [line for line in told if not line.startswith("step")] == [
        "the body as it is, in full",
        "search",
        "the design in full",
        "search, corrected by it",
        "the design in full",
    ]
    assert found.initial == pytest.approx([now[0]])
    assert found.reached == pytest.approx([found.instrument.body.modes_below(math.inf).freq[0]])
    assert found.ok
    assert found.instrument.resolved["body"]["thickness"] == found.values[0]


def test_residual_compliance_is_part_of_a_measured_body_s_mobility() -> None:
    """The sum over poles and conjugates, and i w R."""
    basis = ModalBasis.real([700.0], [9.0], {"a": [1.5]}, residual=np.array([[2e-6]]))
    freq = np.array([60.0, 300.0])
    w = 2 * np.pi * freq
    wanted = 1j * w * (1.5**2 / (700.0**2 - w**2 + 18j * w) + 2e-6)
    table = bodies.TabledResonances(basis, basis.poles, basis.right * basis.left, {})
    assert table.mobility(0, freq) == pytest.approx(wanted, rel=1e-9)
    moved = replace(table, less={0: lambda omega: omega})
    assert moved.mobility(0, freq) - wanted == pytest.approx(w, rel=1e-9)


def test_a_tuned_damper_splits_the_resonances_of_a_drawn_body(small) -> None:
    """Poles of modes z and a mass on a spring and a dashpot: z'' + loss + w^2 z = phi F, m y'' = -F at the bridge."""
    m, freq, q = 0.01, 90.0, 5.0
    lines = {"body.thickness": "2e-3 .. 3e-3"}
    damped = small.replace({"body.added": [{"at": "bridge", "mass": m, "frequency": freq, "q": q}]})
    bare, body = (bodies.DrawnDesign(one, parse_free(lines, one), 200.0, mobility=False) for one in (small, damped))
    alone, found = bare.at([2.5e-3]), body.at([2.5e-3])
    assert found.mass == pytest.approx(alone.mass + m)
    own, phi = 2 * np.pi * alone.freq, alone.modes.shapes[list(small.body.points()).index("bridge")]
    n, k = len(own), m * (2 * np.pi * freq) ** 2
    reach, c = np.append(phi, -1.0), np.sqrt(k * m) / q
    mass, stiffness = np.diag([*np.ones(n), m]), np.diag([*own**2, 0.0]) + k * np.outer(reach, reach)
    loss = np.diag([*(own * alone.modes.loss), 0.0]) + c * np.outer(reach, reach)
    flow = np.block(
        [[np.zeros((n + 1, n + 1)), np.eye(n + 1)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, loss)]]
    )
    poles = np.linalg.eigvals(flow)
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    assert found.freq == pytest.approx(np.abs(poles) / 2 / np.pi, rel=1e-2)
    assert found.quality == pytest.approx(np.abs(poles) / -2 / poles.real, rel=0.1)
    less, more, step = body.beside(0)
    assert body.freq_rates(0) == pytest.approx((more.freq - less.freq) / (2 * step))
