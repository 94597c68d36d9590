"""The grand piano against published figures and formulas: inharmonicity, decays, blows, the hardest chord."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
import tonewood.authoring as ta
from pianos import piano
from system_modes import coupled_modes
from tonewood.instrument.inspection.frequencies import held_partials
from tonewood.instrument.inspection.mounted import mounted_pitches
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.string_assembly import stretch_cents
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.playing import perform
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import to_motion
from tonewood.support.units import cents, decibel, ratio_of_cents

#: B of a recorded Yamaha C5 (Salamander samples), by partials 1 to 8: tuning report of kasper0406/piano-emulator
MEASURED_B = {"C3": 1.20e-4, "C4": 2.93e-4, "C5": 8.05e-4, "C6": 2.70e-3}
#: s, prompt T60 of the same piano's samples (`benchmarks/in_the_air.py --sounds`): medians of octaves from C4
RECORDED = (2.75, 1.9, 1.3)


@pytest.fixture(scope="module")
def grand() -> Model:
    return ta.assemble(tw.load_instrument("grand_piano"), 48000)


@pytest.fixture(scope="module")
def middle(tmp_path_factory: pytest.TempPathFactory) -> tw.Instrument:
    return piano(tmp_path_factory.mktemp("middle"), ["C4"])


def test_partials_are_those_of_a_stiff_string_with_measured_inharmonicity(tmp_path: Path) -> None:
    """f_n / n^2 of a string on a rigid bridge grows along a line whose slope is B."""
    model = ta.assemble(piano(tmp_path / "cs", list(MEASURED_B)), 48000)
    for key, measured in MEASURED_B.items():
        string = model.strings[f"{key}_1"]
        freq = np.array(held_partials(string.tuning.coupled(0).bases(string.tension(0))[0], 8))
        n = np.arange(1, len(freq) + 1)
        slope, start = np.polyfit(n**2, (freq / n) ** 2, 1)
        assert slope / start == pytest.approx(measured, rel=0.25)
        # and the law itself, with B = pi^2 EI / (T L^2)
        p = string.resonator.parameters
        B = math.pi**2 * p.bending_stiffness / (string.tension(0) * p.length**2)
        law = n * np.sqrt((1 + B * n**2) / (1 + B)) * freq[0]
        assert np.abs(1200 * np.log2(freq / law)).max() < 0.2


def unison(model: Model, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Poles near C4 of that many equal strings on the board, and their shares of energy per string."""
    string = model.strings["C4_1"]
    basis = string.tuning.coupled(0).bases(string.tension(0))[0]
    upper = 2500.0
    names = [f"s{i}" for i in range(count)]
    end = next(iter(string.polarizations[0].ends))
    joints = [Connection(name, (Term(name, "bridge"), Term("body", end, -1.0)), Rigid()) for name in names]
    found = coupled_modes(dict.fromkeys(names, basis) | {"body": model.body}, joints, freq_upper=upper)
    near = np.abs(found.freq / string.freq() - 1) < 0.02
    strings = [found.components.index(name) for name in names]
    mine = near & (found.shares[:, strings].sum(axis=1) > 0.5)
    return found.poles[mine], found.shares[mine][:, strings]


def test_unisons_decay_as_weinreich_says(middle: tw.Instrument) -> None:
    """In phase N strings lose N times as much to the board as one; against each other they keep their own rate."""
    model = ta.assemble(middle.replace({"tuning.stretch": "none"}), 12000)
    (one,), _ = unison(model, 1)
    three, _ = unison(model, 3)
    assert len(three) == 3
    p = model.strings["C4_1"].resonator.parameters
    own = p.loss.parameters.sigma0 + p.loss.parameters.sigma1 * (math.pi / p.length) ** 2
    rates = np.sort(-three.real)
    assert rates[:2] == pytest.approx([own, own], rel=0.01)
    assert rates[2] - own == pytest.approx(3 * (-one.real - own), rel=0.1)
    assert rates[2] / rates[0] > 4


@pytest.mark.slow
def test_a_struck_unison_decays_twice(middle: tw.Instrument, tmp_path: Path) -> None:
    """Early in phase, late by the mistuned motion: slower by the share that a single string has not."""
    note = [tw.Note(0.0, 20.0, note=60, velocity_midi=80)]

    def rates(instrument: tw.Instrument) -> tuple[float, float]:
        sound = tw.render(tw.Score(note), instrument, fs=12000, max_duration=14.0).samples[:, 0]
        t = np.arange(sound.size) / 12000
        freq = ta.assemble(instrument, 12000).strings[next(iter(instrument.groups))].freq()
        # the fundamental alone
        shifted = sound * np.exp(-2j * np.pi * freq * t)
        window = np.hanning(1201)
        level = 20 * np.log10(np.abs(np.convolve(shifted, window / window.sum(), "same")))
        early, late = (np.polyfit(t[a:b], level[a:b], 1)[0] for a, b in ((1200, 18000), (72000, 160000)))
        return -float(early), -float(late)

    early, late = rates(middle)
    assert early > 2.5 * late
    # one string alone, muted by felt wedges, decays slower at first than three
    first, _ = rates(piano(tmp_path / "one", ["C4"], {"strings": "1", "una_corda": "1", "cents_2": "", "cents_3": ""}))
    assert first < 0.6 * early


def test_una_corda_leaves_more_aftersound(tmp_path: Path) -> None:
    """The string that is not struck soon moves against the others: softer at first, and longer; mean of three keys."""
    found = []
    for key, number in (("C4", 60), ("C5", 72), ("E5", 76)):
        instrument = piano(tmp_path / key, [key])
        note = [tw.Note(0.05, 12.0, note=number, velocity_midi=80)]

        def levels(
            *controls: tw.Control, instrument: tw.Instrument = instrument, note: list[tw.Note] = note
        ) -> np.ndarray:
            sound = tw.render(tw.Score(note, controls), instrument, fs=12000, max_duration=10.0).samples[:, 0]
            # strings beat about once in 3 s: a long window
            early, late = sound[1200:7200], sound[36000:118000]
            return 10 * np.log10([np.mean(early**2), np.mean(late**2)])

        found.append(levels(tw.Control(0.0, "cc67", 1.0)) - levels())
    assert all(-6 < early < -1 for early, _ in found)
    early, late = np.mean(found, axis=0)
    assert late > early + 4


def test_one_head_strikes_three_strings(middle: tw.Instrument) -> None:
    """The head loses the momentum that the felts give: m (v - v') = sum of the felts' impulses; energy is not made."""
    model = ta.assemble(middle, 96000)
    engine = Engine(model, perform(tw.Score([tw.Note(0.02, 0.5, note=60, velocity_midi=90)]), model).timeline)
    felts = [j for j, c in enumerate(model.system.connections) if c.name.endswith(".felt")]
    assert len(felts) == 3
    assert sum(name.endswith(".head") for name in model.system.names) == 1
    basis = model.system.compiled[model.system.slot("C4_1.hammer.head")].basis
    mass = middle.exciter("hammer", "C4_1").parameters.mass

    def velocity() -> float:
        numbers = np.array(engine.system.modes_of(engine.state, "C4_1.hammer.head"), dtype=np.float64)
        return float(to_motion(basis, numbers)[1] @ basis.right[0].real)

    engine.advance(1)
    engine.advance(math.ceil((0.0198 * 96000 - engine.state.sample) / 64))
    before, stepper = velocity(), KernelStepper(engine.system)
    _, forces = stepper.run(engine.state, 320, engine.gestures.injections, engine.gestures.controls)
    impulse = forces[:, felts].sum(axis=0) / 96000
    # the rest of its suspension takes or gives less than a hundredth meanwhile
    assert impulse.sum() == pytest.approx(mass * (before - velocity()), rel=0.01)
    assert np.ptp(impulse) < 0.02 * impulse.max()
    # it touches for some 2 ms, as hammers in the middle of a piano do
    assert 1.5e-3 < np.count_nonzero(forces[:, felts[0]]) / 96000 < 2.5e-3


def test_louder_is_brighter(middle: tw.Instrument) -> None:
    """Felt hardens: from pp to ff the upper partials rise by more than the lower."""

    def balance(velocity: float) -> float:
        note = [tw.Note(0.02, 1.0, note=60, velocity_midi=velocity)]
        sound = tw.render(tw.Score(note), middle, fs=24000, max_duration=0.4).samples[:, 0]
        power = np.abs(np.fft.rfft(sound * np.hanning(sound.size))) ** 2
        freq = np.fft.rfftfreq(sound.size, 1 / 24000)
        low, high = power[(freq > 200) & (freq < 1000)].sum(), power[(freq > 2500) & (freq < 6000)].sum()
        return decibel(math.sqrt(high / low))

    soft, middling, loud = balance(25), balance(70), balance(115)
    assert middling > soft + 3
    assert loud > middling + 2


@pytest.mark.validate
def test_every_key_sounds_its_stretched_note(grand: Model) -> None:
    stretch = stretch_cents(grand.instrument)
    found = ta.pitches(grand)
    assert len(found) == 88
    wolves: list[str] = []
    for at, together in zip(found, mounted_pitches(grand, found), strict=True):
        wanted = grand.instrument.tuning.freq(at.note) * ratio_of_cents(stretch[at.string])
        off = abs(cents(at.freq / wanted))
        if off >= 0.01:
            # on a mode of the board neither of the two is the string's: no tension puts it in tune
            wolves.append(at.string)
            assert at.wolf is not None
            assert off < 10
            continue
        # one of the modes of each mistuned unison is near the note
        assert min(abs(c) for c, _ in together.modes) < 1.0
    assert len(wolves) <= 2


@pytest.mark.validate
def test_decays_of_all_keys(grand: Model) -> None:
    """Rates against sigma0 + sigma1 k^2 + 2 f Z Re Y N with the board's own mobility, and against the sound."""
    ratios: list[float] = []
    decays: list[float] = []
    for at in ta.pitches(grand):
        string = grand.strings[at.string]
        p, n = string.resonator.parameters, len(string.group)
        end = next(iter(string.polarizations[0].ends))
        mobility = grand.body.frf(np.array([at.wanted_freq]), end, end)[0].real
        impedance = math.sqrt(at.tension * p.linear_density)
        rate = (
            p.loss.parameters.sigma0
            + p.loss.parameters.sigma1 * (math.pi / p.length) ** 2
            + 2 * at.wanted_freq * impedance * mobility * n
        )
        ratios.append(math.log(1000) / rate / at.t60)
        decays.append(at.t60)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.03)
    # near a resonance of the board the coupling is not weak, and the formula gives too much
    assert np.percentile(ratios, 5) > 0.85
    assert np.percentile(ratios, 95) < 1.1
    # the median of an octave: the bass rings longer than recorded, docs/in_the_air.md says how much
    for octave, recorded in zip((slice(39, 51), slice(51, 63), slice(63, 76)), RECORDED, strict=True):
        assert 0.5 < np.median(decays[octave]) / recorded < 2.2


@pytest.mark.validate
def test_all_keys_at_once_as_loud_as_can_be(grand: Model) -> None:
    notes = [tw.Note(0.02, 0.1, note=n, velocity_midi=127) for n in range(21, 109)]
    score = tw.Score(notes, [tw.Control(0.0, "cc64", 1.0)])
    sound = tw.render(score, grand.instrument, fs=48000, max_duration=0.4).samples
    assert np.isfinite(sound).all()
    one = tw.render(
        tw.Score([tw.Note(0.02, 0.1, note=60, velocity_midi=127)]), grand.instrument, max_duration=0.4
    ).samples
    assert np.abs(sound).max() < 88 * np.abs(one).max()


@pytest.mark.validate
def test_the_whole_account_closes(grand: Model) -> None:
    notes = [
        tw.Note(0.01 + 0.004 * i, 0.03, note=n, velocity_midi=100) for i, n in enumerate((21, 45, 60, 64, 79, 100))
    ]
    controls = [tw.Control(0.015, "cc64", 1.0), tw.Control(0.05, "cc64", 0.5), tw.Control(0.03, "cc67", 1.0)]
    trace = tw.render(tw.Score(notes, controls), grand.instrument, max_duration=0.08, energy=True).energy
    assert trace is not None
    put_in = sum(v.sum() for v in trace.supplied.values())
    assert trace.worst_residual <= 1e-10
    assert trace.worst_cumulative_residual * trace.peak <= 1e-10 * put_in


@pytest.mark.validate
@pytest.mark.parametrize("fs", [8000, 192000])
def test_other_rates(fs: int) -> None:
    notes = [tw.Note(0.02 + i / 15, 0.03, note=n, velocity_midi=100) for i, n in enumerate((36, 60, 36, 60))]
    sound = tw.render(tw.Score(notes, [tw.Control(0.0, "cc64", 0.5)]), "grand_piano", fs=fs, max_duration=0.3).samples
    assert np.isfinite(sound).all()
    assert 0.001 < np.abs(sound).max() < 1.0
