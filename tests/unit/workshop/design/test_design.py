"""Designs of small bodies: targets reached, checked by the computation that renders use, and targets out of reach."""

import math
from itertools import pairwise

import numpy as np
import pytest
import yaml

from tonewood.errors import BundleError, TonewoodError
from tonewood.instrument.bundle.added import body_parts
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import assemble
from tonewood.workshop.design.bodies import DrawnDesign, MeasuredDesign
from tonewood.workshop.design.figures import StringEnd, string_ends, worst_wolf
from tonewood.workshop.design.folder import check_folder, write_design
from tonewood.workshop.design.search import find_design, slope
from tonewood.workshop.design.sensitivity import sensitivity, words
from tonewood.workshop.design.task import parse_free, parse_targets, read_task
from tonewood.workshop.design.words import lines, trades

BOX = {
    "schema": "tonewood-instrument/2",
    "name": "box",
    "body": {
        "plugin": "drawn_body",
        "fmax": 800.0,
        "cell": 0.03,
        "outline": {"points": [[0.0, 0.0], [0.30, 0.0], [0.30, 0.22], [0.0, 0.22]]},
        "wood": {"species": "sitka_spruce"},
        "thickness": 2.5e-3,
        "edge": {"kind": "hinged"},
        "braces": {"b": {"start": [0.06, 0.05], "stop": [0.26, 0.16], "width": 0.008, "height": 6e-3}},
        "soundhole": {"centre": [0.08, 0.15], "radius": 0.03},
        "air": {"depth": 0.09, "cavity_to": 700.0},
        "points": {"bridge": {"at": [0.20, 0.10]}},
    },
}


@pytest.fixture
def box(tmp_path):
    (tmp_path / "box").mkdir()
    (tmp_path / "box" / "instrument.yaml").write_text(yaml.safe_dump(BOX))
    return Instrument.load(tmp_path / "box")


@pytest.mark.validate
def test_a_design_reaches_its_targets_and_is_written(box, tmp_path):
    targets = parse_targets(["A0 = 96", "mass <= 0.12"], box)
    free = parse_free({"body.thickness": "2e-3 .. 4e-3", "body.braces.*.height": "x 0.5 .. 2"}, box)
    design = find_design(box, targets, free)
    assert design.ok
    made = write_design(design, tmp_path / "made")
    modes = made.body.modes_below(math.inf)
    assert modes.freq[modes.named()["A0"]] == pytest.approx(96.0, rel=0.005)
    assert modes.masses.sum() < 0.12 * 1.005
    assert any("body.thickness" in line for line in lines(design))


@pytest.mark.validate
def test_three_parameters_and_t1_beside_another_mode(box):
    """Targets that another body has, T1 and its neighbour among them, one of them one-sided."""
    far = {"body.thickness": 2.9e-3, "body.braces.b.height": 9e-3, "body.soundhole.radius": 0.034}
    modes = box.replace(far).body.modes_below(math.inf)
    named = modes.named()
    beside = named["T1"] + 1
    assert modes.freq[beside] < 1.25 * modes.freq[named["T1"]]
    lines = [f"A0 = {modes.freq[named['A0']]:.4f}", f"T1 = {modes.freq[named['T1']]:.4f}"]
    lines.append(f"mode {beside + 1} >= {modes.freq[beside]:.4f}")
    bounds = {"body.thickness": "2e-3 .. 4e-3", "body.braces.*.height": "x 0.5 .. 2"}
    free = parse_free(bounds | {"body.soundhole.radius": "0.02 .. 0.045"}, box)
    told = []
    assert find_design(box, parse_targets(lines, box), free, told.append).ok
    assert sum(line.startswith("step") for line in told) <= 16


@pytest.mark.validate
def test_targets_out_of_reach_are_missed_and_said_so(box):
    targets = parse_targets(["A0 = 130", "mass <= 0.07"], box)
    design = find_design(box, targets, parse_free({"body.thickness": "2.3e-3 .. 2.7e-3"}, box))
    assert not design.ok
    text = "\n".join(lines(design))
    assert "cannot be reached" in text
    assert "MISSED" in text
    assert any("rise and fall together" in line for line in trades(design))


def test_an_added_mass_on_a_measured_body(tmp_path):
    guitar = Instrument.load("classical_guitar")
    point = next(name for name, p in guitar.body.points().items() if p.driven)
    guitar = guitar.replace({"body.added": [{"at": point, "mass": 0.004}]})
    basis = body_parts(guitar.spec.body.added, guitar.body.basis(2e4), guitar.body.points()).body
    now = np.sort(basis.natural_freq)[1]
    wanted = float(now * 0.985)
    free = parse_free({"body.added.0.mass": "0.001 .. 0.1"}, guitar)
    design = find_design(guitar, parse_targets([f"mode 2 = {wanted:.4f}"], guitar), free)
    added = design.instrument.spec.body.added
    whole = body_parts(added, design.instrument.body.basis(2e4), guitar.body.points()).body
    assert design.values[0] > 0.004
    assert np.sort(whole.natural_freq)[1] == pytest.approx(wanted, rel=0.005)


@pytest.mark.slow
def test_sensitivity_against_differences_and_rayleigh(box):
    """The cents from 2.45 to 2.55 mm; of a gram -600 / ln 2 phi^2 1e-3 cents. Modes 2 and 3 veer: their sum is told."""
    found = sensitivity(box)
    low, mid, high = (box.replace({"body.thickness": h}).body.modes_below(math.inf) for h in (2.45e-3, 2.5e-3, 2.55e-3))
    pair = np.array([[1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 1]])
    cents = 1200 * np.log2(high.freq[:4] / low.freq[:4])
    np.testing.assert_allclose(pair @ found.rows["0.1 mm of thickness"][:4], pair @ cents, rtol=0.02)
    gram = -600 / np.log(2) * 1e-3 * mid.shapes[0, :4] ** 2
    np.testing.assert_allclose(pair @ found.rows["1 g at bridge"][:4], pair @ gram, rtol=0.02, atol=0.05)
    assert set(found.labels) >= {"A0", "T1"}
    assert "0.1 mm of braces.b.height" in found.rows
    assert any(line.startswith("1 g at bridge") for line in words(found))


@pytest.mark.slow
def test_a_mode_is_followed_by_its_shape_past_another(box):
    """A thicker top raises T1 through another mode: its number changes, its shape does not."""
    body = DrawnDesign(box, parse_free({"body.thickness": "1.5e-3 .. 5e-3"}, box), 500.0, mobility=False)
    shapes, numbers = [], []
    for h in np.linspace(2.0e-3, 4.5e-3, 6):
        found = body.at([float(h)])
        k = found.named["T1"]
        shapes.append(body._modes[1][:, k])
        numbers.append(k)
    mass = body._whole.mass_matrix
    alike = [(a @ (mass @ b)) ** 2 / ((a @ (mass @ a)) * (b @ (mass @ b))) for a, b in pairwise(shapes)]
    assert min(alike) > 0.5
    assert len(set(numbers)) > 1


class OneMode:
    """A mode of 200 Hz."""

    def __init__(self, q, mass):
        self.freq, self.quality, self.squares = np.array([200.0]), np.array([q]), np.array([[1 / mass]])


def test_a_wolf_is_where_coupling_exceeds_losses():
    """String of 3 g at 200 Hz: K = (2 Q / pi) sqrt(2 m / M) is 1 at Q = pi / 2 / sqrt(2 m / M)."""
    end = StringEnd("D3", 0, 3e-3 * 200.0, 147.0, 440.0)
    q = math.pi / 2 / math.sqrt(2 * 3e-3 / 0.2)
    assert worst_wolf(OneMode(q, 0.2), [end], (170.0, 230.0)) == pytest.approx(0.0, abs=1e-9)
    assert worst_wolf(OneMode(2 * q, 0.2), [end], (100.0, 400.0)) == pytest.approx(
        1200 * math.log2(200 / 142.8), rel=0.01
    )
    assert worst_wolf(OneMode(2 * q, 0.2), [end], (210.0, 400.0)) == pytest.approx(1200 * math.log2(200 / 210))


@pytest.mark.parametrize(
    ("targets", "free", "said"),
    [
        (["T1 == 200"], {"body.thickness": "2e-3 .. 3e-3"}, "T1 == 200"),
        (["loud = 3"], {"body.thickness": "2e-3 .. 3e-3"}, "no target"),
        (["mobility brige 80..800 >= -30"], {"body.thickness": "2e-3 .. 3e-3"}, "bridge"),
        (["T1 = 200"], {"body.thicknes": "2e-3 .. 3e-3"}, "body.thickness"),
        (["T1 = 200"], {"body.thickness": "3e-3 .. 2e-3"}, "LOW .. HIGH"),
        (["T1 = 200"], {"body.points": "0 .. 1"}, "keep their differences"),
        (["no wolf F3..A3"], {"body.thickness": "2e-3 .. 3e-3"}, "without strings"),
        ([], {"body.thickness": "2e-3 .. 3e-3"}, "1 to 40"),
    ],
)
def test_lines_that_are_refused(box, targets, free, said):
    def parsed():
        return parse_targets(targets, box), parse_free(free, box)

    with pytest.raises(TonewoodError, match=said):
        parsed()


def test_targets_say_by_how_much_they_are_missed(box):
    """Cents, percent or dB: above and below for =, on one side alone for <= and >=."""
    lines = ["mode 2 = 200", "T1 <= 200", "A0 >= 100", "mass <= 0.5", "mobility bridge 80..800 >= -30"]
    mode, top, air, mass, mobility = parse_targets(lines, box)
    assert (mode.mode, top.mode, air.mode) == ("2", "T1", "A0")
    assert [t.unit for t in (mode, top, air, mass, mobility)] == ["cents", "cents", "cents", "%", "dB"]
    assert (mode.off(400.0), mode.off(100.0)) == pytest.approx((1200.0, -1200.0))
    assert (top.off(400.0), top.off(100.0)) == pytest.approx((1200.0, 0.0))
    assert (air.off(400.0), air.off(50.0)) == pytest.approx((0.0, -1200.0))
    assert (mass.off(0.55), mass.off(0.45)) == pytest.approx((10.0, 0.0))
    assert (mobility.at, mobility.band) == ("bridge", (80.0, 800.0))
    assert (mobility.off(-20.0), mobility.off(-33.0)) == pytest.approx((0.0, -3.0))
    for target, tolerance in ((mode, 8.5), (mass, 0.5), (mobility, 0.5)):
        assert target.tolerance == tolerance
    for ends in ("mode 2 = 5", "mode 2 = 3000", "mobility bridge 5..3000 >= -30"):
        assert parse_targets([ends], box)
    for beyond in (
        "mode 2 = 4.9",
        "mode 2 = 3001",
        "mass = 0",
        "mobility bridge 4..90 >= 0",
        "mobility bridge 9..9 >= 0",
    ):
        with pytest.raises(TonewoodError, match=beyond.split()[0]):
            parse_targets([beyond], box)


def test_numbers_that_a_pattern_frees(box):
    """Each by its place in lists and mappings; several keep their ratios by a factor, one its own bounds."""
    (thickness,) = parse_free({"body.thickness": "2e-3 .. 3e-3"}, box)
    assert (thickness.paths, thickness.base, thickness.low, thickness.high) == (
        ("body.thickness",), (2.5e-3,), 2e-3, 3e-3,
    )  # fmt: skip
    (brace,) = parse_free({"body.braces.*.start": "x 0.5 .. 2"}, box)
    assert dict(zip(brace.paths, brace.base, strict=True)) == {
        "body.braces.b.start.0": 0.06, "body.braces.b.start.1": 0.05,
    }  # fmt: skip
    with pytest.raises(TonewoodError, match=r"sets body\.thickness, which body\.thickness sets as well"):
        parse_free({"body.thickness": "2e-3 .. 3e-3", "body.thick*": "x 0.9 .. 1.1"}, box)


@pytest.mark.parametrize(("bounds", "wrong"), [("-1e-3 .. 3e-3", "-0.001"), ("x 0 .. 1", "0"), ("+ 0 .. 1", "1")])
def test_bounds_are_values_that_the_bundle_allows(box, bounds, wrong):
    with pytest.raises(TonewoodError, match=rf"body\.thickness: its bound {wrong} cannot be: .* 0\.0001 to 0\.1 m"):
        parse_free({"body.thickness": bounds}, box)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("targets: T1 = 200\n", "targets"),
        ("targets: [T1 = 200, 3]\n", "targets"),
        ("targets: [T1 = 200]\nfree: [a]\n", "free"),
        ("targets: [T1 = 200]\nfree: {body.thickness: 3e-3}\n", "free"),
    ],
)
def test_a_file_of_other_lines_is_refused(tmp_path, text, key):
    (tmp_path / "task.yaml").write_text("targets: [T1 = 200]\nfree: {body.thickness: 2e-3 .. 3e-3}\n")
    assert read_task(tmp_path / "task.yaml") == (["T1 = 200"], {"body.thickness": "2e-3 .. 3e-3"})
    (tmp_path / "task.yaml").write_text(text)
    with pytest.raises(TonewoodError, match=key):
        read_task(tmp_path / "task.yaml")


def test_what_a_free_number_sets(box):
    """A value, a factor on each or a number added to each; it begins where it is, or at the nearer bound."""
    lines = {
        "body.thickness": "2e-3 .. 2.4e-3",
        "body.braces.b.start": "x 0.5 .. 2",
        "body.soundhole.centre": "+ -1 .. 1",
    }
    value, factor, shift = parse_free(lines, box)
    assert [free.start for free in (value, factor, shift)] == [2.4e-3, 1.0, 0.0]
    assert value.overrides(2.2e-3) == {"body.thickness": 2.2e-3}
    assert factor.overrides(2.0) == pytest.approx({"body.braces.b.start.0": 0.12, "body.braces.b.start.1": 0.1})
    assert shift.overrides(0.01) == pytest.approx({"body.soundhole.centre.0": 0.09, "body.soundhole.centre.1": 0.16})


def test_a_file_with_another_key_is_refused(tmp_path):
    (tmp_path / "task.yaml").write_text("target: [T1 = 200]\n")
    with pytest.raises(TonewoodError, match="targets"):
        read_task(tmp_path / "task.yaml")


@pytest.mark.slow
def test_a_tuned_damper_on_a_drawn_body(box):
    """Resonances beside a design, of the damper's numbers and of the plate's, are those of bodies computed there."""
    heavy = box.replace({"body.added": [{"at": "bridge", "mass": 0.01, "frequency": 150.0, "q": 5.0}]})
    bounds = {
        "body.added.0.frequency": "100 .. 200",
        "body.added.0.mass": "0.005 .. 0.02",
        "body.thickness": "2e-3 .. 3e-3",
    }
    body, middle = DrawnDesign(heavy, parse_free(bounds, heavy), 500.0, mobility=True), np.array([150.0, 0.01, 2.5e-3])
    bare = DrawnDesign(box, parse_free({"body.thickness": "2e-3 .. 3e-3"}, box), 500.0, mobility=False).at([2.5e-3])
    now = body.at(middle)
    assert len(now.freq) == len(bare.freq) + 1
    assert now.mass == pytest.approx(bare.mass + 0.01)
    for i in range(3):
        body.at(middle)
        less, more, step = body.beside(i)
        wide = np.eye(3)[i] * 1e-3 * middle[i]
        low, high = body.at(middle - wide), body.at(middle + wide)
        for name in ("freq", "quality", "squares"):
            rate = (getattr(more, name) - getattr(less, name))[..., :6] / (2 * step)
            wanted = (getattr(high, name) - getattr(low, name))[..., :6] / (2 * wide[i])
            np.testing.assert_allclose(rate, wanted, rtol=0.02, atol=2e-3 * np.abs(wanted).max())


@pytest.fixture(scope="module")
def lumped():
    """A measured body with a lump of 4 g on its first driven point."""
    guitar = Instrument.load("classical_guitar")
    point = next(name for name, p in guitar.body.points().items() if p.driven)
    return guitar.replace({"body.added": [{"at": point, "mass": 0.004, "stiffness": 2e4, "damping": 0.5}]})


def test_a_measured_body_beside_its_parameters_is_the_body_solved_again(lumped):
    """Frequencies, Q, masses and mobility to first order, against differences; mobility against the sum of poles."""
    bounds = {"mass": "0.001 .. 0.02", "stiffness": "1e3 .. 1e5", "damping": "0.1 .. 5"}
    free = parse_free({f"body.added.0.{key}": text for key, text in bounds.items()}, lumped)
    body, freq = MeasuredDesign(lumped, free), np.geomspace(80.0, 700.0, 50)
    values, far = np.array([p.start for p in free]), np.array([p.high - p.low for p in free])
    now = body.at(values)
    iw = 2j * np.pi * freq[:, None]
    pairs = now.residues[0] / (iw - now.poles) + now.residues[0].conj() / (iw - now.poles.conj())
    direct = iw[:, 0] * (pairs.sum(axis=1) + now.basis.residual[0, 0])
    np.testing.assert_allclose(now.mobility(0, freq), direct, rtol=1e-9)

    def seen(found):
        return [found.freq, found.quality, found.squares[0], found.mobility(0, freq)]

    for i in range(len(free)):
        body.at(values)
        less, more, step = body.beside(i)
        below, above = (body.at(values + by * 1e-4 * far * np.eye(len(free))[i]) for by in (-1, 1))
        for a, b, c, d in zip(*(seen(found) for found in (less, more, below, above)), strict=True):
            told, true = (b - a) / (2 * step), (d - c) / (2e-4 * far[i])
            np.testing.assert_allclose(told, true, rtol=1e-3, atol=1e-3 * np.abs(true).max())


def test_ends_of_strings_are_where_the_bundle_has_them():
    """The mass of a string times its frequency is sqrt(T mu) / 2 at every stop (Mersenne)."""
    guitar = Instrument.load("classical_guitar")
    model, points = assemble(guitar, 16000), list(guitar.body.points())
    ends = string_ends(guitar)
    assert [end.name for end in ends] == list(guitar.spec.strings)
    for end in ends:
        assert points[end.point] == guitar.spec.strings[end.name].body_points[0]
        density = guitar.resonators[end.name].linear_density
        assert end.mass_freq == pytest.approx(0.5 * math.sqrt(model.strings[end.name].tension(0) * density), rel=0.01)
        assert end.low == pytest.approx(440 * 2 ** ((model.strings[end.name].open_note - 69) / 12))
        assert end.high / end.low == pytest.approx(2 ** (guitar.spec.stops.count / 12))


def test_a_measured_design_is_written_as_it_is_said(lumped, tmp_path):
    """Reached targets, with a bundle that has the mode; and a target out of reach, with the bound that stops it."""
    modes = np.sort(body_parts(lumped.spec.body.added, lumped.body.basis(2e4), lumped.body.points()).body.natural_freq)
    wanted = 0.99 * float(modes[1])
    free = parse_free({"body.added.0.mass": "0.001 .. 0.05"}, lumped)
    design = find_design(lumped, parse_targets([f"mode 2 = {wanted:.4f}", "mode 1 <= 2000"], lumped), free)
    said = [line for line in lines(design) if line.startswith("  mode")]
    assert ["reached within" in line or line.endswith("; reached") for line in said] == [True, True]
    assert said[1].endswith("; reached")
    assert not any("cannot be reached" in line for line in lines(design))
    # a tenth of the range, as it is said, against the body with so much more
    (told,) = [line for line in lines(design) if line.startswith("  body.added.0.mass +0.0049: mode 2 ")]
    body = MeasuredDesign(lumped, free)
    now, more = (body.at([float(design.values[0]) + by]).freq[1] for by in (0.0, 1e-4))
    cents = 49 * 1200 * math.log2(more / now)
    assert float(told.split()[4]) == pytest.approx(cents, rel=0.1)
    made = write_design(design, tmp_path / "made")
    found = np.sort(body_parts(made.spec.body.added, made.body.basis(2e4), made.body.points()).body.natural_freq)
    assert (made.name, found[1]) == ("made", pytest.approx(wanted, rel=5e-3))
    missed = find_design(lumped, parse_targets([f"mode 2 = {0.5 * wanted:.4f}"], lumped), free)
    text = "\n".join(lines(missed))
    assert "MISSED by" in text
    assert "cannot be reached within these bounds: mode 2" in text
    assert "body.added.0.mass stands at its upper bound" in text


def test_the_slope_of_an_error_is_its_derivative(box):
    for text, figure in (("mode 2 = 200", 260.0), ("mass = 0.5", 0.6), ("mobility bridge 80..800 >= -30", -40.0)):
        (target,) = parse_targets([text], box)
        change = target.off(figure * (1 + 1e-6)) - target.off(figure * (1 - 1e-6))
        assert slope(target, figure) == pytest.approx(change / (2e-6 * figure), rel=1e-6)


def test_the_folder_of_a_design_has_the_name_of_an_instrument(tmp_path):
    check_folder(tmp_path / "made_2")
    for name in ("2made", "ma-de", "made.x"):
        with pytest.raises(BundleError, match="cannot be the name"):
            check_folder(tmp_path / name)


def test_a_target_about_wolves_is_of_the_pitches_that_it_names(lumped):
    (target,) = parse_targets(["no wolf F3..A3"], lumped)
    assert (target.kind, target.sense, target.value, target.unit) == ("wolf", "<=", 0.0, "cents")
    assert target.band == pytest.approx((440 * 2 ** (-16 / 12), 220.0))
    assert (target.off(-30.0), target.off(30.0)) == (0.0, 30.0)
