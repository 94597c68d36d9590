"""Rules that every plugin found must keep, whoever wrote it."""

from __future__ import annotations

import dataclasses
import pickle
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tonewood.errors import PluginError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.attached import Site
from tonewood.instrument.contract.base import KINDS, Attachment, Exciter, Plugin, Resonator
from tonewood.instrument.contract.gestures import Event
from tonewood.instrument.contract.losses import Loss, StringData
from tonewood.instrument.contract.registry import check_plugin, list_instruments, list_plugins
from tonewood.support.params import Parameters, quantity

PLUGINS = {name: cls for name, cls in list_plugins().items() if name != "bedded_string"}  # has tests of its own
INSTRUMENTS = list_instruments()


@pytest.fixture(scope="module")
def used() -> dict[str, list[Plugin[Any]]]:
    """Every plugin as some installed instrument uses it."""
    found: dict[str, list[Plugin[Any]]] = {}
    for name in INSTRUMENTS:
        i = Instrument.load(name)
        parts = [(i.spec.body, i.body)]
        parts += [(i.spec.strings[n], r) for n, r in i.resonators.items()]
        parts += [(i.spec.exciters[n], e) for n, e in i.exciters.items()]
        parts += [(i.spec.connections[n], a) for n, a in i.attachments.items()]
        parts += [(o, i.pickups[o.name]) for o in i.spec.outputs]
        for spec, plugin in parts:
            found.setdefault(spec.plugin, []).append(plugin)
        for law in (law for r in i.resonators.values() for law in r.inner if isinstance(law, Loss)):
            found.setdefault(law.law, []).append(law)
    return found


@pytest.mark.parametrize("name", PLUGINS)
def test_declares_itself(name: str) -> None:
    cls = PLUGINS[name]
    check_plugin(cls, name)
    assert cls.kind in KINDS
    assert cls.__doc__
    for key, field in cls.Parameters.model_fields.items():
        assert field.description, key
        if field.annotation is float:
            extra = field.json_schema_extra
            assert isinstance(extra, dict), key
            assert extra.get("unit"), f"{name}.{key} has no unit"


@pytest.mark.parametrize("name", PLUGINS)
def test_refuses_unknown_keys(name: str) -> None:
    with pytest.raises(Exception, match=r"no_such_key: is not a known key|is missing"):
        PLUGINS[name].from_values({"no_such_key": 1.0}, key="part")


#: parts that no installed instrument uses
UNUSED = {"valette", "bedded_string"}
#: resonators that `test_strings` cannot take from an instrument as it takes strings
OTHERS = {"gong", *UNUSED}
VALETTE = {"diameter": 0.43e-3, "delta_ve": 4.5e-3, "inverse_q_te": 2.03e-4}


@pytest.mark.parametrize("name", [n for n in PLUGINS if n not in UNUSED])
def test_some_instrument_shows_it(name: str, used: dict[str, list[Plugin[Any]]]) -> None:
    assert name in used


@pytest.mark.parametrize("name", [n for n, p in PLUGINS.items() if issubclass(p, Loss)])
def test_loss_laws(name: str, used: dict[str, list[Plugin[Any]]]) -> None:
    """Partials that lose energy or keep it, each by itself, whatever else is asked for."""
    omega = 2 * np.pi * np.geomspace(20.0, 2e4, 30)
    for law in used.get(name) or [PLUGINS[name].from_values(VALETTE)]:
        assert isinstance(law, Loss)
        string = StringData(70.0, 4e-3, 5e-5)
        k = omega / np.sqrt(70.0 / 4e-3)
        eta = np.broadcast_to(law.eta(omega, k, string), omega.shape)
        assert (eta >= 0.0).all()
        np.testing.assert_array_equal(eta[::3], np.broadcast_to(law.eta(omega[::3], k[::3], string), (10,)))


#: a gong has no stops and no tension, and refuses the first
@pytest.mark.parametrize("name", [n for n, p in PLUGINS.items() if issubclass(p, Resonator) and n not in OTHERS])
def test_strings(name: str, used: dict[str, list[Plugin[Any]]]) -> None:
    string = used[name][0]
    assert isinstance(string, Resonator)
    whole = string.basis(3000.0)
    assert whole.is_real
    assert (whole.natural_freq <= 3000.0).all()
    assert (whole.damping_rate >= 0).all()
    assert "bridge" in whole.points
    # the same every time, and nothing remembered that could move
    np.testing.assert_array_equal(whole.poles, string.basis(3000.0).poles)
    shorter = string.basis(3000.0, stop=0.2 * string.length)
    assert shorter.n_modes < whole.n_modes
    stretched = string.detuned(whole, 1.02 * string.tension)
    # frequency goes with the root of the tension, less the share of the bending
    ratio = stretched.natural_freq / whole.natural_freq
    assert ratio.min() > 1.0
    assert ratio.max() <= np.sqrt(1.02) + 1e-9
    assert ratio[0] == pytest.approx(np.sqrt(1.02), rel=1e-3)
    displacement, velocity = string.transfer(whole, shorter)
    assert displacement.shape == velocity.shape == (shorter.n_modes, whole.n_modes)
    at_bridge = shorter.right[shorter.index("bridge")].real @ displacement
    np.testing.assert_allclose(at_bridge, whole.right[whole.index("bridge")].real, atol=1e-9)


@pytest.mark.parametrize("name", [n for n, p in PLUGINS.items() if issubclass(p, Exciter)])
def test_gestures(name: str, used: dict[str, list[Plugin[Any]]]) -> None:
    from tonewood.instrument.contract.gestures import Place

    for exciter in used[name]:
        assert isinstance(exciter, Exciter)
        gesture = exciter.gesture(Event({}, 110.0, length_before=0.69), Place("A2", 0.65))
        assert gesture.segments or gesture.motions or gesture.noise
        for pieces in (gesture.segments, *(m.segments for m in gesture.motions)):
            for before, after in pairwise(pieces):
                assert before.start < before.stop <= after.start + 1e-12
        assert np.isfinite(gesture.start)
        assert gesture.start < gesture.stop
        assert dataclasses.is_dataclass(gesture)
        # doubled when asked to, until the string is let go: how may depend on the force
        if gesture.segments and gesture.on is None and "force" in type(exciter.parameters).model_fields:
            twice = exciter.gesture(
                Event({"force": 2 * exciter.parameters.force}, 110.0, length_before=0.69), Place("A2", 0.65)
            )
            times = np.linspace(gesture.start, min(gesture.stop, 0.0) if gesture.start < 0 else gesture.stop, 50)
            np.testing.assert_allclose([twice.force(t) for t in times], [2 * gesture.force(t) for t in times])


SITE = Site("A2", 0.65, 0.52, (0.65, 0.6, 0.56, 0.52, 0.48), (("A2.z", (0.0, 0.0, 1.0)), ("A2.y", (0.0, 1.0, 0.0))))


@pytest.mark.parametrize("name", [n for n, p in PLUGINS.items() if issubclass(p, (Exciter, Attachment))])
def test_what_touches_strings(name: str, used: dict[str, list[Plugin[Any]]]) -> None:
    """Names of its own, laws that can only store or lose, and at every stop the same connections."""
    for plugin in used[name]:
        assert isinstance(plugin, Exciter | Attachment)
        attached = plugin.attach("part", SITE)
        if attached is None:
            assert not issubclass(PLUGINS[name], Attachment)
            continue
        assert attached.connections
        names = [c.name for c in attached.connections]
        assert len(set(names)) == len(names)
        assert all(n.startswith("A2.part.") for n in (*names, *attached.components, *attached.inputs))
        assert all(p.startswith("part.") for p in attached.places)
        assert set(attached.resting) <= set(names)
        points = {("A2.z", p) for p in (*attached.places, "bridge", "pluck")}
        points |= {("A2.y", p) for _, p in points}
        points |= {(c, p) for c, basis in attached.components.items() for p in basis.points}
        for connection in attached.connections:
            assert {(t.component, t.point) for t in connection.terms} <= points
        for basis in attached.components.values():
            assert basis.is_real
            assert (basis.damping_rate >= 0).all()
        for entries in attached.inputs.values():
            assert {(component, point) for component, point, _ in entries} <= points
        open_string = plugin.attach("part", dataclasses.replace(SITE, length=0.65))
        assert open_string is not None
        assert [(c.name, c.terms) for c in open_string.connections] == [(c.name, c.terms) for c in attached.connections]


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_instruments_name_their_figures(name: str) -> None:
    """Every number of a bundle is said to be measured, published, computed, authored or a stand-in."""
    instrument = Instrument.load(name)
    settings = ("provenance", "sources", "oversampling", "draft_oversampling")
    figures = [p for p, v in _leaves(instrument.resolved) if isinstance(v, int | float) and not isinstance(v, bool)]
    unknown = [p for p in figures if p.split(".")[0] not in settings and instrument.origins.of(p) is None]
    assert unknown == []
    assert instrument.spec.licence


def _leaves(value: Any, path: str = "") -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [leaf for k, v in value.items() for leaf in _leaves(v, f"{path}.{k}" if path else str(k))]
    if isinstance(value, list):
        return [leaf for i, v in enumerate(value) for leaf in _leaves(v, f"{path}.{i}")]
    return [(path, value)]


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_instruments_cross_processes(name: str) -> None:
    """Plain data are enough for a worker to make the same instrument."""
    instrument = Instrument.load(name)
    again = Instrument.from_values(pickle.loads(pickle.dumps(dict(instrument.resolved))), instrument.folder)
    assert again.resolved == instrument.resolved
    assert again.content_hash == instrument.content_hash


class _Numbers(Parameters):
    x: float = quantity("m", default=1.0, doc="a length")


class _Undocumented(Parameters):
    x: float = 1.0


def _exciter(**more: Any) -> type:
    body = {"Parameters": _Numbers, "gesture": lambda self, event, place: None, **more}
    return type("Made", (Exciter,), body)


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (42, "is not a class derived from"),
        (int, "is not a class derived from"),
        (Plugin, "must derive from exactly one of"),
        (_exciter(api=2), "version 2 of the contract; this is version 1"),
        (_exciter(Parameters=dict), "has no `Parameters`"),
        (_exciter(Parameters=Parameters), "has no `Parameters`"),
        (_exciter(Parameters=_Undocumented), "does not say what it is"),
        (type("Made", (Exciter,), {"Parameters": _Numbers}), "leaves out gesture"),
    ],
)
def test_a_broken_plugin_is_named(found: object, reason: str) -> None:
    with pytest.raises(PluginError, match=rf"^plugin 'x' of somebody.*{reason}"):
        check_plugin(found, "plugin 'x' of somebody")


def test_a_sound_plugin_passes() -> None:
    check_plugin(_exciter(), "plugin 'x' of somebody")
