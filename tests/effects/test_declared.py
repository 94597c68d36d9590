"""Declared effects, and the choices auto, all, none and lists of names."""

from __future__ import annotations

import math

import numpy as np
import pytest
from effect_scenes import duet, renderer, sound

import tonewood as tw
from tonewood.instrument.contract.effects import Norms, rise_of_tension
from tonewood.instrument.contract.registry import list_instruments, list_plugins
from tonewood.instrument.model.assembly import assemble
from tonewood.instrument.model.choice import declared


@pytest.mark.parametrize("name", sorted(list_plugins()))
def test_a_plugin_tells_all_about_its_effects(name: str) -> None:
    effects = list_plugins()[name].effects
    assert len({effect.name for effect in effects}) == len(effects)
    for effect in effects:
        assert effect.name.isidentifier()
        assert effect.unit == {"additive": "dB", "detuning": "cents"}[effect.kind]
        assert all(text and "\n" not in text for text in (effect.adds, effect.before, effect.during))
        assert 0.0 <= effect.cost(10) <= effect.cost(20)
        quiet, loud = (Norms(level=x, energy=x, axial_stiffness=1e4) for x in (1e-4, 1e-2))
        assert effect.bound(quiet) < effect.bound(loud)


def test_strings_bodies_contacts_and_outputs_declare() -> None:
    plugins = list_plugins()
    found = {name: {e.name for e in plugin.effects} for name, plugin in plugins.items()}
    assert found["stiff_string"] == {"second_polarization"}
    assert found["tension_modulated_string"] - found["stiff_string"] == {"tension_modulation"}
    for name in ("frets", "fingerboard", "bridge_barrier", "rattle"):
        assert found[name] == {name}
    assert found["modal_table"] == {"body_modes"}
    assert found["point_pickup"] == found["modal_radiation"] == {"outputs"}
    assert "dampers" in found["pluck_ramp"]


def test_the_bound_of_a_rise_is_that_of_the_string_vibrating_in_one_mode() -> None:
    # y'' + w^2 y (1 + EA/T (pi y / 2L)^2) = 0 is Duffing's equation: dw/w = 3/8 of the cubic term's share
    axial, tension, length, amplitude = 14612.0, 104.1, 0.645, 1e-3
    shift = 3 / 8 * axial / tension * (math.pi * amplitude / (2 * length)) ** 2
    energy = tension * (math.pi * amplitude) ** 2 / (4 * length)
    bound = rise_of_tension(Norms(energy=energy, tension=tension, axial_stiffness=axial, length=length))
    assert bound == pytest.approx(1200 / math.log(2) * shift, rel=1e-12)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks={"grand_piano": pytest.mark.validate, "drawn_guitar_x": pytest.mark.slow}.get(n, ()))
        for n in sorted(list_instruments())
    ],
)
def test_none_keeps_every_string_in_one_plane(name: str) -> None:
    instrument = tw.load_instrument(name)
    whole = assemble(instrument, 16000)
    plain = assemble(instrument.replace({"effects.mode": "none"}), 16000)
    assert list(plain.strings) == list(whole.strings)
    assert not plain.system.potentials
    ends = [c.name for c in plain.system.connections if c.role == "bridge"]
    assert ends == [f"{string.components[0]}.bridge" for string in plain.strings.values()]
    kept = {c.part for c in plain.system.connections} & set(instrument.attachments)
    assert not [part for part in kept if instrument.attachments[part].effects]


def test_none_is_linear() -> None:
    def play(force: float) -> np.ndarray:
        return sound(renderer([tw.Note(0.0, 1, note=64, force=force)], 0.3, duet(mode="none")))

    once, thrice = play(2.0), play(6.0)
    assert abs(once).max() > 0
    # twice the rounding of a sample: the first 5 ms are differences to the value at frame 0
    assert abs(thrice - 3 * once).max() < 2e-11 * abs(thrice).max()


def test_none_leaves_the_body_and_what_is_heard() -> None:
    """And what plays it: without these there is no sound. All else is named by who wants it."""
    basic = {"body_modes", "outputs", "plectrum", "stopping_finger"}
    assert assemble(duet(mode="none"), 16000).choice.names == basic
    assert assemble(duet(mode=["tension_modulation"]), 16000).choice.names == basic | {"tension_modulation"}


def test_names_choose_what_runs() -> None:
    chosen = assemble(duet(mode=["tension_modulation"]), 16000)
    assert [t.name for t in chosen.system.potentials] == ["B3", "E4"]
    assert [len(s.polarizations) for s in chosen.strings.values()] == [1, 1]
    known = declared(duet().plugins)
    with pytest.raises(tw.TonewoodError, match=r"^effects: there is no effect 'glides'; auto, all, none or ") as fault:
        assemble(duet(mode=["glides"]), 16000)
    assert all(name in str(fault.value) for name in known)


def test_what_is_given_to_a_render_goes_before_the_bundle() -> None:
    score = tw.Score([tw.Note(0.0, 1, note=64, force=1.0)])
    a = tw.Renderer(score, duet(mode="all"), 16000, effects="auto", budget_db=-60.0, budget_cents=2.0)
    assert (a.model.choice.mode, a.model.choice.budget_db, a.model.choice.budget_cents) == ("auto", -60.0, 2.0)
    b = tw.Renderer(score, duet(mode="none"), 16000)
    assert b.model.choice.mode == "none"
    with pytest.raises(tw.TonewoodError, match="budget_cents"):
        tw.Renderer(score, duet(), 16000, budget_cents=-1.0)
