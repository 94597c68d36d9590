"""Tensions that are left a little higher instead of rising: what that is worth, and what it takes from a string."""

from __future__ import annotations

import math

import numpy as np
import pytest
from effect_scenes import FS, compared, duet, renderer, sound

import tonewood as tw
from tonewood.engine.engine import GRID
from tonewood.engine.fretting import Fretting
from tonewood.engine.switching import LOWEST, Rise, TensionSwitch, raising
from tonewood.instrument.assembly import assemble
from tonewood.instrument.effects import Norms, rise_of_tension
from tonewood.numerics.motion import from_motion, to_motion
from tonewood.numerics.stored_energy import stored_energy

NOTE = tw.Note
AXIAL, TENSION, LENGTH = 14612.0, 104.1, 0.645


def test_the_bound_is_that_of_two_partials_by_averaging() -> None:
    """Of V = EA/(8 L) (s1 cos^2 a + s2 cos^2 b)^2, averaged over both phases, the derivative by each energy s T / 2."""
    s1, s2 = 4e-6, 3e-6
    phase = 2 * np.pi * np.arange(64) / 64
    a, b = np.cos(phase[:, None]) ** 2, np.cos(phase) ** 2
    slope = np.mean(AXIAL / (4 * LENGTH) * (s1 * a + s2 * b) * a)  # dV/ds1; V0 = T s1 / 2 cos^2, energy T s1 / 2
    off = 1200 / math.log(2) * slope / (TENSION / 2) / 1.0
    norms = Norms(
        energy=TENSION / 2 * (s1 + s2), partial=TENSION / 2 * s1, tension=TENSION, axial_stiffness=AXIAL, length=LENGTH
    )
    # a frequency is dE/dJ: its relative change is that of the energy at a given action
    assert rise_of_tension(norms) == pytest.approx(off, rel=1e-9)


def test_what_is_raised_already_does_not_count() -> None:
    rise = Rise(mean=0.6, own=0.1)
    assert rise.off(0.0) == pytest.approx(0.7)
    assert rise.off(0.45) == pytest.approx(0.25)
    assert Rise(0.0, 0.0).off(0.45) == pytest.approx(0.45)


def test_raised_by_so_much_that_loud_and_silent_are_within_the_budget() -> None:
    switch = TensionSwitch(assemble(duet(mode="auto", budget_cents=0.5), FS))
    assert switch.raised("E4", Rise(0.3, 0.1)) == 0.0
    assert switch.raised("E4", Rise(0.6, 0.15)) == pytest.approx(0.45)
    assert switch.raised("E4", Rise(0.75, 0.2)) is None
    assert switch.raised("E4", Rise(math.inf, math.inf)) is None
    # nothing stops rising while it is played, and what is raised for a pluck stays so until it is let go
    assert switch.wanted("E4", Rise(0.0, 0.0), None, busy=True) is None
    assert switch.wanted("E4", Rise(0.0, 0.0), 0.45, busy=True) == 0.45
    assert switch.wanted("E4", Rise(1.0, 0.2), 0.45, busy=True) is None


def test_the_strongest_partial_of_a_plucked_string() -> None:
    """A string drawn aside at beta L has 2 sin^2(n pi beta) / (n pi)^2 / (beta (1 - beta)) of its energy in mode n."""
    model = assemble(duet(mode="auto", budget_cents=0.5), FS)
    switch, system = TensionSwitch(model), model.system
    state = system.start()
    basis = system.compiled[system.slot("E4.z")].basis
    # static under a force at the plucking point, its bridge held: so far as its modes reach
    static = basis.right[basis.index("pluck")].real / basis.stiffness
    end = basis.right[basis.index("bridge")].real
    held = static - (end / basis.stiffness) * (end @ static) / (end @ (end / basis.stiffness))
    system.modes_of(state, "E4.z")[:] = from_motion(basis, held, 0 * held)
    energy = switch.energies(system, state)["E4"]
    tension, length = switch._held("E4", 0.0)
    # as loud as makes the question one of shares
    state.modes *= math.sqrt(0.5 * 2 * length * tension**2 / (switch.stiffness[1] * energy * 1200 / math.log(2) / 2))
    energy = switch.energies(system, state)["E4"]
    beta = model.strings["E4"].pluck_from_bridge / length
    n = np.arange(1, LOWEST + 1)
    share = 2 * np.sin(n * np.pi * beta) ** 2 / (n * np.pi) ** 2 / (beta * (1 - beta))
    swing, _ = switch.seen(system, state, "E4", 0.0, energy)
    assert swing.partial / energy == pytest.approx(share.max(), rel=0.03)
    assert switch.seen(system, state, "E4", 0.0, 1e-9)[0].partial == 1e-9  # far below any budget nobody asks


def test_a_string_raised_sounds_as_much_sharper() -> None:
    string = assemble(duet(), FS).strings["E4"]
    low = string.bases()["E4.z"]
    high = string.raised({"E4.z": low}, 5.0)["E4.z"]
    ratio = 2 ** (5.0 / 1200)
    a, bending = low.metadata["tension_part"], low.metadata["bending_part"]
    assert high.metadata["tension"] == pytest.approx(low.metadata["tension"] * ratio**2, rel=1e-12)
    stiff = string.resonator.parameters.bending_stiffness * bending
    np.testing.assert_allclose(high.stiffness - stiff, (low.stiffness - stiff) * ratio**2, rtol=1e-9)
    assert np.array_equal(low.right, high.right)
    assert a.shape == low.stiffness.shape


def test_what_raising_takes_is_what_energy_there_is_more() -> None:
    model = assemble(duet(mode="auto", budget_cents=0.5), FS)
    system = model.system.with_tensions([])
    state = system.start()
    rng = np.random.default_rng(5)
    for name in ("E4.z", "E4.y"):
        modes = system.modes_of(state, name)
        modes[:] = 1e-6 * rng.normal(size=modes.shape)
    from tonewood.engine.fretting import Fingerboard

    board = Fingerboard(model)
    bases = board.bases("E4", Fretting(raised=0.45))
    other, higher = state.copy(), system.with_compiled(bases)
    for name in ("E4.z", "E4.y"):
        q, v = to_motion(system.compiled[system.slot(name)].basis, system.modes_of(state, name))
        higher.modes_of(other, name)[:] = from_motion(bases[name].basis, q, v)
    gained = stored_energy(higher, other).modes - stored_energy(system, state).modes
    assert raising(system, state, "E4", 0.45) == pytest.approx(gained, rel=1e-6)
    assert gained > 0


#: a pluck whose rise lies between what may be left out and what has to rise
NOTES = [NOTE(0.0, 2, note=64, force=1.15), NOTE(0.5, 2, note=64, force=1.1)]


def test_a_tension_left_higher_is_within_the_budget_of_one_that_rises() -> None:
    stream, every = renderer(NOTES, 2.0, duet(mode="auto")), renderer(NOTES, 2.0, duet(mode="all"))
    raised, blocks = set(), []
    for block in stream.blocks(512):
        blocks.append(block)
        raised.add(stream.engine.frettings["E4"].raised)
    assert max(raised) == pytest.approx(0.45)
    assert not stream.engine.ledger.tense["E4"].samples  # and none has risen
    auto, all_ = np.concatenate(blocks)[:, 0], sound(every)[:, 0]
    worst = 0.0
    for freq in (329.6, 659.3):
        cents, level = compared(all_, auto, freq)
        assert len(cents) > 5
        assert abs(cents).max() < 0.5
        assert abs(level).max() < 0.5
        worst = max(worst, abs(cents).max())
    # it is off by what is left out: the comparison sees it
    assert worst > 0.1


def test_a_string_whose_tension_stops_rising_waits_until_that_is_cheap() -> None:
    engine = renderer([NOTE(0.0, 3, note=64, force=3.0)], 3.0, duet()).engine
    before = None
    while engine.state.sample < 2.5 * FS:
        snapshot = engine.snapshot()
        engine.advance(1)
        if "E4" in snapshot.tense and "E4" not in engine.tense:
            before = snapshot
            break
    assert before is not None
    assert engine.frettings["E4"].raised > 0
    other = renderer([NOTE(0.0, 3, note=64, force=3.0)], 3.0, duet()).engine
    other.restore(before)
    # the switch comes first in the interval: all that is stored before and after it
    stored = stored_energy(other.system, other.state).total
    other._control()
    after = stored_energy(other.system, other.state).total
    assert stored * (1 - 1e-3) < after <= stored * (1 + 1e-12)
    assert other.state.sample % GRID == 0
