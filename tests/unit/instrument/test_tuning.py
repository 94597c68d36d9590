"""Tuning against the exact end of a stiff string, and the coupled eigenproblem of all its modes."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from system_modes import CoupledModes, coupled_modes
from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.frequencies import pitch
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.instrument.model.tuning import CoupledMode, StringOnBody, TunedStop
from tonewood.lab.string_end import ExactString, coupled_pole
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Ports

Make = Callable[..., Instrument]


@pytest.fixture(scope="module")
def guitar() -> Model:
    return assemble(Instrument.load("classical_guitar"), 16000.0)


def on_body(model: Model, string: str, stop: int) -> CoupledModes:
    held = model.strings[string]
    joints = [c for c in model.system.connections if c.name in {f"{n}.bridge" for n in held.components}]
    return coupled_modes({"body": model.system.compiled[0].basis, **held.bases(stop)}, joints)


def dominated(modes: CoupledModes, component: str, near: float) -> float:
    """Frequency of the mode with the largest share in a component, within a third of `near`."""
    close = np.abs(1200 * np.log2(modes.freq / near)) < 400
    share = np.where(close, modes.shares[:, modes.components.index(component)], -1)
    return float(modes.freq[int(np.argmax(share))])


@pytest.mark.parametrize(("string", "stop"), [("E2", 0), ("E2", 4), ("A2", 11), ("D3", 7), ("G3", 2), ("E4", 19)])
def test_the_dominating_mode_of_the_eigenproblem_is_in_tune(guitar: Model, string: str, stop: int) -> None:
    found = dominated(on_body(guitar, string, stop), f"{string}.z", guitar.strings[string].freq(stop))
    assert abs(1200 * math.log2(found / guitar.strings[string].freq(stop))) < 0.01


def test_tension_is_that_of_the_exact_string(make: Make) -> None:
    """One polarization, rate-proportional loss: the tuned tension put into the exact end condition."""
    changes = {"strings.*.loss": {"law": "sigma", "sigma0": 0.6}, "strings.*.end_compliance": 0.0}
    model = assemble(make().replace(changes), 16000.0)
    string = model.strings["D3"]
    body = model.system.compiled[0].basis
    point = body.index("bridge")
    residues = body.right[point] * body.left[point]

    def receptance(s: complex) -> complex:
        total = np.sum(residues / (s - body.poles) + np.conj(residues) / (s - np.conj(body.poles)))
        return complex(total + body.residual[point, point])

    for stop in (0, 5):
        exact = ExactString(string.length(stop), string.tension(stop), 1.95e-3, 4e-5, 0.6)
        pole = coupled_pole(exact, receptance, 1)
        cents = 1200 * math.log2(pole.imag / (2 * math.pi) / string.freq(stop))
        assert abs(cents) < 0.02
        tuned = string.tuned(stop)
        assert tuned is not None
        assert -tuned.modes[0].pole.real == pytest.approx(-pole.real, rel=1e-3)


def test_every_stop_within_a_cent_or_a_wolf(guitar: Model) -> None:
    """On the low and the high string; the others take the same way."""
    for name in ("E2", "E4"):
        string = guitar.strings[name]
        for stop in range(string.n_stops + 1):
            tuned = string.tuned(stop)
            assert tuned is not None
            if abs(tuned.error_cents) > 1.0:
                assert tuned.wolf is not None
                # no tension does better: a little more and a little less both miss by as much or more
                for factor in (0.99, 1.01):
                    coupled, freq = string.tuning.coupled(stop), string.freq(stop)
                    other = coupled.modes(tuned.tension * factor, freq)[0]
                    assert abs(1200 * math.log2(other.freq / freq)) > abs(tuned.error_cents)


def test_body_resonance_makes_a_wolf(guitar: Model) -> None:
    """G sharp on the low string, beside the 102 Hz resonance: two modes share the string nearly evenly."""
    tuned = guitar.strings["E2"].tuned(4)
    assert tuned is not None
    wolf = tuned.wolf
    assert wolf is not None
    assert abs(1200 * math.log2(wolf.freq / tuned.modes[0].freq)) < 60
    assert wolf.shares[0] > 0.3
    quiet = guitar.strings["E2"].tuned(8)
    assert quiet is not None
    assert quiet.wolf is None


def test_planes_of_which_one_meets_a_body_mode_keep_their_own_modes(guitar: Model) -> None:
    """A body mode at the pitch that moves along z alone: the modes are those of z on it and of y on a rigid end."""
    string, tension = guitar.strings["D3"], guitar.strings["D3"].tension(0)
    bases, freq = string.tuning.coupled(0).bases(tension), string.freq(0)
    mode = ModalBasis.real([2 * math.pi * freq], [20.0], {"bridge": [1.0]}, modal_mass=0.2)
    moving, rigid = np.array([[1.0], [0.0]]), np.array([[0.0]])

    def poles(planes: slice, rows: np.ndarray) -> list[complex]:
        coupled = StringOnBody(lambda _: bases[planes], Ports.of(mode, rows), 0.1)
        return [pole for pole, _ in coupled.poles(coupled.joint(tension), freq)]

    alone = [*poles(slice(0, 1), moving[:1]), *poles(slice(1, 2), rigid)]
    both = poles(slice(0, 2), moving)
    assert len(both) == len(alone) == 3
    key = np.imag
    np.testing.assert_allclose(sorted(both, key=key), sorted(alone, key=key), rtol=1e-9)
    assert 0.01 < max(np.imag(alone)) / min(np.imag(alone)) - 1 < 0.2  # z and the body split


def test_the_level_of_a_mode_is_that_of_its_energy() -> None:
    """a exp(-sigma t): int a^2 exp(-2 sigma t) dt = a^2 / 2 sigma."""
    weak, strong = CoupledMode(-8.0 + 600j, (1.0,), 1.0), CoupledMode(-2.0 + 600j, (1.0,), 3.0)
    t = np.linspace(0.0, 8.0, 80001)
    energies = [np.trapezoid((m.strength * np.exp(m.pole.real * t)) ** 2, t) for m in (strong, weak)]
    assert strong.level_db(weak) == pytest.approx(10 * math.log10(energies[0] / energies[1]), abs=1e-3)


@pytest.mark.parametrize("sigma", [None, 40.0])
def test_strength_is_what_a_pluck_does(make: Make, sigma: float | None) -> None:
    """Amplitudes of the two strongest modes in the bridge's motion after a static pull is let go."""
    lossy = {"strings.*.loss": {"law": "sigma", "sigma0": sigma}} if sigma else {}
    model = assemble(make().replace({"strings.D3.note": "F#3", "body.table": "body.csv"} | lossy), 16000.0)
    string = model.strings["D3"]
    tuned = string.tuned(0)
    assert tuned is not None
    first, second = tuned.modes[:2]
    # transfer bridge / pluck just beside each pole, where one mode rules
    basis = string.bases(0)["D3.z"]
    body = model.system.compiled[0].basis

    def transfer(s: complex) -> complex:
        def H(b: object, i: str, j: str) -> complex:
            r, ell = b.right[b.index(i)], b.left[b.index(j)]  # type: ignore[attr-defined]  # a basis
            lam = b.poles  # type: ignore[attr-defined]  # a basis
            total = np.sum(r * ell / (s - lam) + np.conj(r * ell) / (s - np.conj(lam)))
            return complex(total) + b.residual[b.index(i), b.index(j)]  # type: ignore[attr-defined]  # a basis

        force = H(basis, "bridge", "pluck") / (H(basis, "bridge", "bridge") + H(body, "bridge", "bridge"))
        return H(body, "bridge", "bridge") * force

    def residue(s: complex) -> float:
        d = 1e-3
        return abs(0.5 * d * (transfer(s + d) - transfer(s - d)) / s)

    expected = residue(first.pole) / residue(second.pole)
    assert first.strength / second.strength == pytest.approx(expected, rel=1e-4)


def test_open_only_leaves_the_frets_errors(make: Make) -> None:
    each, only = (assemble(make().replace({"tuning.at": at}), 16000.0) for at in ("each_stop", "open_only"))
    assert only.strings["A2"].tension(7) == only.strings["A2"].tension(0)
    tuned = only.strings["A2"].tuned(7)
    assert abs(tuned.error_cents) > 0.05
    exact = each.strings["A2"].tuned(7)
    assert exact is not None
    assert abs(exact.error_cents) < 0.01


def test_without_compensation_tensions_stand(make: Make) -> None:
    string = assemble(make().replace({"tuning.compensate": "none"}), 16000.0).strings["A2"]
    assert string.tension(0) == string.tuned(0).tension == 73.9
    assert string.freq(0) == pytest.approx(110.0)
    assert string.tuning.given.held == "tension"


@pytest.mark.parametrize(
    ("note", "freq", "semitones"), [("C3", 130.8128, -2), ("D4", 293.6648, 12), ("D2", 73.4162, -12)]
)
def test_scordatura(make: Make, note: str, freq: float, semitones: int) -> None:
    """The fundamental, not some partial, sounds the new note."""
    string = assemble(make().replace({"strings.D3.note": note}), 16000.0).strings["D3"]
    tuned = string.tuned(0)
    assert tuned is not None
    assert tuned.freq == pytest.approx(freq, abs=1e-4)
    assert abs(tuned.error_cents) < 0.01
    assert string.tension() / 71.2 == pytest.approx(2 ** (2 * semitones / 12), rel=0.04)


def test_a_note_the_string_cannot_reach(make: Make) -> None:
    with pytest.raises(BundleError, match=r"strings\.D3\.note: 587\.33 Hz needs a tension of 1\.1\de\+03 N"):
        assemble(make().replace({"strings.D3.note": "D5"}), 16000.0)


def test_more_modes_than_a_string_can_have(make: Make) -> None:
    long = {"length": 5.0, "linear_density": 0.1, "tension": 670.0, "note": "C-1", "freq_upper": 1e5}
    with pytest.raises(BundleError, match=r"strings\.A2: this string has some \d+ modes below 100000 Hz; at most 3000"):
        assemble(make().replace({f"strings.A2.{key}": value for key, value in long.items()}), 400000.0)


def test_a_held_tension_moves_the_pitch_and_its_stops(make: Make) -> None:
    """On a rigid end f goes with sqrt(T); the stops keep their intervals to the open string."""
    free = make().replace(
        {"strings.*.end": "body.bridge", "strings.A2.tension": 80.0, "body.points.bridge.direction": "y"}
    )
    by_pitch = assemble(free, 16000.0).strings["D3"]
    assert by_pitch.tuning.given.held == "pitch"
    held = assemble(free.replace({"tuning.hold": "tension", "strings.D3.tension": 80.0}), 16000.0).strings["D3"]
    assert held.tension(0) == 80.0
    tuned = by_pitch.tension(0)
    # bending stiffness takes no part in the ratio: it is 1e-4 of the pitch
    assert held.freq(0) / by_pitch.freq(0) == pytest.approx(math.sqrt(80.0 / tuned), rel=1e-5)
    assert held.tuning.given.cents == pytest.approx(600 * math.log2(80.0 / tuned), abs=0.02)
    for stop in (1, 7, 12):
        assert held.tuning.stops.position(stop) == by_pitch.tuning.stops.position(stop)
        assert held.freq(stop) / held.freq(0) == pytest.approx(2 ** (stop / 12))
        assert abs(held.tuned(stop).error_cents) < 0.01
    assert "its tension of 80 N is held; it sounds" in held.tuning.given.line()


def test_which_of_tension_and_pitch_won_is_said(make: Make) -> None:
    given = assemble(make().replace({"strings.A2.tension": 90.0}), 16000.0).strings["A2"].tuning.given
    assert given.given == 90.0
    assert given.held == "pitch"
    assert given.noticeable
    assert given.cents == pytest.approx(600 * math.log2(90.0 / given.used))
    assert "the 90 N given would sound +" in given.line()
    assert not assemble(make(), 16000.0).strings["A2"].tuning.given.noticeable


@pytest.mark.parametrize("name", ["classical_guitar", "flamenco_guitar", "african_harp", "steel_strings"])
def test_no_shipped_tension_is_far_from_its_note(name: str) -> None:
    model = assemble(Instrument.load(name), 48000.0)
    assert [s.name for s in model.strings.values() if s.tuning.given.noticeable] == []


def test_each_plane_has_the_pitch_of_its_mode_in_the_eigenproblem(guitar: Model) -> None:
    """Near the body's modes the tuned plane is moved, and the other one is left beside the note."""
    off = {}
    for string, stop in (("E2", 4), ("E2", 13), ("A2", 12), ("D3", 0), ("D3", 6), ("D3", 7)):
        found = pitch(guitar, string, stop)
        modes = on_body(guitar, string, stop)
        assert [plane.component for plane in found.planes] == [f"{string}.z", f"{string}.y"]
        for plane in found.planes:
            freq = dominated(modes, plane.component, guitar.strings[string].freq(stop))
            assert abs(1200 * math.log2(plane.freq / freq)) < 0.01
            assert plane.cents == pytest.approx(1200 * math.log2(freq / found.wanted_freq), abs=0.01)
        off[string, stop] = found.planes[1].off_cents
    assert 8.0 < off["D3", 6] < 20.0
    assert -20.0 < off["D3", 7] < -8.0
    assert abs(off["D3", 0]) < 5.0


def test_the_other_plane_on_a_rigid_end_follows_the_tension(make: Make) -> None:
    """A body that moves in z alone: y sounds sqrt(T/mu) / 2 L of the tuned tension, times the split."""
    changes = {
        "strings.*.polarizations": ["z", "y"], "strings.*.end_compliance": 0.0, "strings.*.bending_stiffness": 0.0,
        "strings.*.loss": {"law": "sigma", "sigma0": 0.3}, "strings.*.split_cents": 3.0,
    }  # fmt: skip
    model = assemble(make().replace(changes), 16000.0)
    for stop in (0, 5):
        found = pitch(model, "D3", stop)
        string = model.strings["D3"]
        free = math.sqrt(found.tension / string.resonator.parameters.linear_density) / (2 * string.length(stop))
        assert found.planes[1].split_cents == pytest.approx(3.0)
        assert found.planes[1].off_cents == pytest.approx(1200 * math.log2(free / found.wanted_freq), abs=0.01)


@pytest.mark.parametrize(
    ("off_cents", "strength", "shares", "wolf"),
    [
        (59.0, 0.51, (0.3, 0.7), True), (-59.0, 0.51, (0.3, 0.7), True), (61.0, 0.51, (0.3, 0.7), False),
        (59.0, 0.49, (0.3, 0.7), False), (10.0, 1.0, (0.1, 0.6, 0.3), False), (10.0, 1.0, (0.3, 0.2, 0.5), True),
    ],
)  # fmt: skip
def test_a_wolf_is_within_sixty_cents_and_six_decibels(
    off_cents: float, strength: float, shares: tuple[float, ...], wolf: bool
) -> None:
    """A second mode of the first plane, as strong at the bridge over its whole decay as 6 dB less than the first."""
    first = CoupledMode(complex(-3.0, 2 * math.pi * 200.0), (0.9, *shares[1:-1], 0.1), 1.0)
    other = CoupledMode(complex(-3.0, 2 * math.pi * 200.0 * 2 ** (off_cents / 1200)), shares, strength)
    tuned = TunedStop(200.0, 70.0, (first, other))
    assert (tuned.wolf is not None) is wolf
    apart = TunedStop(200.0 * 2 ** (1.1 / 1200), 70.0, (first, other))  # the first is no longer in tune
    assert (apart.wolf is not None) is (wolf or shares[1] != 0.6)


def test_a_mode_that_decays_at_once_is_weak() -> None:
    """Energy at the bridge over the whole decay, a^2 / (2 sigma): ten times the decay, -10 dB."""
    slow, quick = (CoupledMode(complex(-s, 1000.0), (1.0, 0.0), 0.2) for s in (2.0, 20.0))
    assert quick.level_db(slow) == pytest.approx(-10.0)


@pytest.mark.parametrize("shape", [1e-3, 1e-5])
def test_a_string_on_a_nearly_rigid_body_has_the_tension_of_a_hinged_string(tmp_path: Path, shape: float) -> None:
    """Both planes sound at one frequency, a mode of the body two semitones below: f = sqrt(T / mu (1 + B)) / 2 L,
    B = pi^2 EI / T L^2."""
    folder = shutil.copytree(Instrument.load("monochord").folder, tmp_path / "rigid")
    table = (folder / "body.csv").read_text()
    (folder / "body.csv").write_text(table.replace(",1\n", f",{shape}\n"))
    tuned, length = assemble(Instrument.load(folder), 16000.0).strings["A2"].tuned(20), 0.90 * 2 ** (-20 / 12)
    wanted = 110.0 * 2 ** (20 / 12)
    assert tuned.tension == pytest.approx(
        1.5e-3 * (2 * length * wanted) ** 2 - (math.pi / length) ** 2 * 2e-4, rel=2e-5
    )
    assert abs(tuned.error_cents) < 1e-3
