"""Phantom partials and sidebands, and their bounds, by values worked out by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from effect_scenes import FS, duet
from effects_by_hand import replace_moment, shaken

from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects import bridge_response, runtime_effects, sidebands
from tonewood.performance.effects.base import (
    Switching,
)
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.phantom_partials import PhantomPartialsEffect
from tonewood.performance.effects.phantoms import PartialSlopes, Phantoms
from tonewood.performance.effects.sidebands import Plane, Sidebands
from tonewood.performance.effects.usage import EffectUsage
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.potentials.tension import stretch_weights
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.stepping.forcing import Segment
from tonewood.physics.stepping.motion import to_motion

# -- phantom partials --------------------------------------------------------------------------------------------------


def hand_phantoms() -> Phantoms:
    rng = np.random.default_rng(3)
    parts = {name: PartialSlopes(rng.normal(size=(3, 4)), rng.normal(size=(3, 4))) for name in ("a", "b")}
    return Phantoms(parts, rng.uniform(size=(2, 3, 3)), rng.uniform(size=(3, 3)))


def test_slopes_levels_and_cents_of_phantom_partials_by_loops() -> None:
    found, rng = hand_phantoms(), np.random.default_rng(4)
    moving = {name: (rng.normal(size=4), rng.normal(size=4)) for name in ("a", "b")}
    wanted = []
    for i in range(3):
        total = 0.0
        for name, (q, v) in moving.items():
            d = sum(found.parts[name].displaced[i, k] * q[k] for k in range(4))
            m = sum(found.parts[name].moving[i, k] * v[k] for k in range(4))
            total += d * d + m * m
        wanted.append(math.sqrt(total))
    slopes = found.slopes(moving)
    assert slopes == pytest.approx(wanted)
    pairs = list(itertools.product(range(3), repeat=2))
    levels = [sum(found.heard[r, i, j] * slopes[i] * slopes[j] for i, j in pairs) for r in range(2)]
    assert found.level(slopes, np.array([1.0, 1e9])) == pytest.approx(levels[0])
    assert found.level(slopes, np.array([2.0 * levels[0], 4.0 * levels[1]])) == pytest.approx(0.5)
    assert found.cents(slopes) == pytest.approx(sum(found.detuning[i, j] * slopes[i] * slopes[j] for i, j in pairs))
    assert found.parts["a"].first(2).displaced.shape == (2, 4)


def test_phantom_bounds_are_sums_over_pairs_of_partials_and_axial_modes() -> None:
    """The module's formulas, pair by pair, with the products cos i cos j = (cos(i + j) + cos(i - j)) / 2."""
    high = {"connections.frets.action_first": 3e-3, "connections.frets.action_twelfth": 6e-3}
    changes = {"strings.B3.plugin": "geometric_string", **high}
    model = assemble(duet(mode="all").replace(changes), FS)
    system, response = model.system, BridgeResponse(model)
    law = system.potentials[0]
    compiled = {name: system.compiled[system.slot(name)] for name in law.components}
    T = model.strings["B3"].tension(0)
    found = Phantoms.of(law, compiled, T, response)
    ends = [HeldModes.of(compiled[name].basis, "bridge") for name in law.transverse]
    axial = HeldModes.of(compiled[law.longitudinal].basis, "bridge")
    n = len(found.detuning)
    assert n == min(int(np.sum(h.freq_rad < 2 * np.pi * law.freq_coupled)) for h in ends)
    freq = [min(float(h.freq_rad[i]) for h in ends) for i in range(n)]

    def sizes(at: float) -> np.ndarray:
        return response.heard_at(law.longitudinal, np.array([at]))[:, 0]

    click = response.stopped_at(law.longitudinal, response.freq_rad[:1])[:, 0]
    for i, j in ((0, 0), (0, 1), (2, 5), (n - 1, n - 2), (3, 3)):
        heard, moved = np.zeros(len(found.heard)), 0.0
        for order in range(axial.n_modes + 1):
            # (C_i cos i + C_j cos j)^2 has the order-th cosine where i + j or |i - j| is the order
            product = 0.5 * ((i + j + 2 == order) + (abs(i - j) == order))
            driven = 0.25 * law.axial_stiffness * product
            if not driven:
                continue
            answers = []
            for side, W in enumerate((abs(freq[i] - freq[j]), freq[i] + freq[j])):
                answer = 1.0
                if order:
                    W0, s = float(axial.freq_rad[order - 1]), float(axial.damping_rate[order - 1])
                    away = max(abs(W0**2 - W**2) - 2 * 0.0006 * W**2, 0.0)
                    answer = math.hypot(W**2, 2 * s * W) / math.hypot(away, 2 * s * W + 1e-9 * W0**2)
                answers.append(answer)
                if i != j or side == 1:
                    heard += driven * answer * sizes(W)
            after = sizes(float(axial.freq_rad[order - 1])) if order else click
            heard += driven * after * (2.0 + (sum(answers) if order else 0.0))
            moved += driven * sum(answers) if order else 0.0
        np.testing.assert_allclose(found.heard[:, i, j], heard, rtol=1e-9)
        assert found.detuning[i, j] == pytest.approx(600 / math.log(2) / T * moved, rel=1e-9)


def test_a_force_that_stops_leaves_integrals_of_the_response() -> None:
    """|H| = 1 from v0 to v1: (1/pi) ((w - v0) / w + ln(v1 / w)); |H| = v: ((w^2 - v0^2) / 2w + v1 - w) / pi."""
    freq = np.geomspace(10.0, 1e4, 4001)
    flat = bridge_response._stopped(np.ones((1, 1, freq.size)), freq)[0, 0]
    np.testing.assert_allclose(flat, ((freq - 10.0) / freq + np.log(1e4 / freq)) / np.pi, rtol=1e-4)
    rising = bridge_response._stopped(freq[None, None], freq)[0, 0]
    np.testing.assert_allclose(rising, ((freq**2 - 100.0) / (2 * freq) + 1e4 - freq) / np.pi, rtol=1e-4)


def test_responses_of_the_outputs_are_those_of_the_stepped_body(model: Model) -> None:
    """The force of a string on its bridge, read by a radiating body: the sum over the body's modes, at its points."""
    response, system = BridgeResponse(model), model.system
    body = system.compiled[system.slot("body")].basis
    w = response.freq_rad
    assert np.all(np.diff(w) > 0.0)
    assert w[0] == pytest.approx(2 * np.pi * 20.0)
    inside = np.abs(body.poles.imag)
    inside = inside[(inside > 2 * np.pi * 20) & (inside < np.pi * FS)]
    assert np.isin(inside, w).all()
    for c, component in enumerate(response.components):
        end = next(k for k in system.connections if k.name == f"{component}.bridge")
        entry = {t.point: t.factor for t in end.terms if t.component == "body"}
        shape = sum(f * body.right[body.index(p)] for p, f in entry.items())
        left = sum(f * body.left[body.index(p)] for p, f in entry.items())
        k = len(w) // 3
        s = 1j * w[k]
        own = np.sum(shape * left / (s - body.poles) + (shape * left).conj() / (s - body.poles.conj()))
        own += sum(
            f * g * body.residual[body.index(p), body.index(q)] for p, f in entry.items() for q, g in entry.items()
        )
        assert response.mobility[c, k] == pytest.approx(abs(own) * w[k], rel=1e-6)
    middle = response.heard_at(response.components[0], w[5:7])
    np.testing.assert_array_equal(middle, response.heard[:, 0, 5:7])
    half = response.heard_at(response.components[0], np.array([0.5 * (w[5] + w[6])]))
    np.testing.assert_allclose(half[:, 0], response.heard[:, 0, 5:7].mean(axis=1))
    np.testing.assert_array_equal(response.stopped_at(response.components[1], w[9:10]), response.stopped[:, 1, 9:10])


def plane(n: int, readouts: int, seed: int) -> Plane:
    rng = np.random.default_rng(seed)
    shape = rng.uniform(0.5, 1.0, 4)
    stiffness = rng.uniform(1.0, 2.0, 4)
    return Plane(
        stiffness, shape, rng.normal(size=(n, 4)), rng.normal(size=(n, 4)), rng.normal(size=4),
        rng.uniform(size=(readouts, n, 13)), rng.uniform(size=(readouts, 13)), rng.uniform(size=readouts),
    )  # fmt: skip


def test_the_level_of_sidebands_by_loops() -> None:
    """Partials of two planes: beats by the mean stretch of each of the twelve lowest, the rest together."""
    planes, rng = {"a": plane(3, 2, 5), "b": plane(14, 2, 6)}, np.random.default_rng(7)
    moving = {name: (rng.normal(size=4), rng.normal(size=4)) for name in planes}
    found, rise, peak = Sidebands(planes, 0.01), 0.01, np.array([2.0, 3.0])
    beats, totals, bending, sizes, aboves = np.zeros(12), 0.0, 0.0, {}, {}
    for name, p in planes.items():
        q, v = moving[name]
        potential = 0.5 * max(p.stiffness @ (q * q) - (p.shape @ q) ** 2 / np.sum(p.shape**2 / p.stiffness), 0.0)
        kinetic = 0.5 * max(v @ v - (p.shape @ v) ** 2 / (p.shape @ p.shape), 0.0)
        assert p.energies(q, v) == pytest.approx((potential, kinetic))
        sizes[name] = [math.hypot(p.bent[i] @ q, p.moving[i] @ v) for i in range(len(p.bent))]
        squares = [0.5 * s * s for s in sizes[name]]
        above = max(potential + kinetic - sum(squares), 0.0)
        aboves[name] = math.sqrt(2 * above)
        bending += potential
        totals += sum(squares) + above
        for m, square in enumerate(squares[:12]):
            beats[m] += square
    shares = [rise * b for b in beats] + [rise * max(totals - beats.sum(), 0.0)]
    heard = np.zeros(2)
    for name, p in planes.items():
        for r in range(2):
            for i, size in enumerate(sizes[name]):
                heard[r] += size * sum(p.heard[r, i, m] * shares[m] for m in range(13))
            heard[r] += aboves[name] * sum(p.above[r, m] * shares[m] for m in range(13))
            heard[r] += p.stopped[r] * 4 * rise * bending * abs(p.bridge_force @ moving[name][0])
    assert found.level(moving, peak) == pytest.approx(max(heard / peak))
    still = {name: (0 * q, 0 * v) for name, (q, v) in moving.items()}
    assert found.level(still, peak) == 0.0
    # a pluck adds its partials to those that sound, amplitude to amplitude
    q = rng.normal(size=4)
    alone = Sidebands({"a": planes["a"]}, rise)
    drawn = {"a": (q, np.zeros(4))}
    from_rest = alone.level({"a": (0 * q, 0 * q)}, peak, {"a": q})
    bent = max(
        planes["a"].stopped * 4 * rise * planes["a"].energies(q, 0 * q)[0] * abs(planes["a"].bridge_force @ q) / peak
    )
    assert from_rest <= alone.level(drawn, peak) <= from_rest + bent


def test_planes_with_the_same_modes_are_recognised(model: Model) -> None:
    one, other = (model.system.compiled[model.system.slot(c)].basis for c in ("E4.z", "B3.z"))
    assert sidebands._same_modes(one, one)
    assert not sidebands._same_modes(one, other)


# -- phantom partials run ----------------------------------------------------------------------------------------------


def phantoms(budget_db: float = -80.0) -> tuple[Model, PhantomPartialsEffect]:
    strings = {f"strings.{name}.plugin": "phantom_string" for name in ("B3", "E4")}
    model = assemble(duet(mode="auto", budget_db=budget_db).replace(strings), FS)
    (effect,) = (e for e in runtime_effects(model) if isinstance(e, PhantomPartialsEffect))
    return model, effect


def test_phantom_partials_run_on_all_strings_for_a_while_after_a_gesture() -> None:
    """Of 64 samples of 24 kHz 15 are 40 ms; motion spreads for 0.15 s."""
    model, effect = phantoms()
    assert effect.components == ("B3", "E4")
    quiet, spreading = Switching(), Switching(until={"": 1000})
    assert [effect.next_watch(s, spreading) for s in (0, 14 * GRID, 15 * GRID)] == [15 * GRID, 15 * GRID, 30 * GRID]
    at = replace_moment(model, {}, GRID)
    assert effect.watch(at, quiet) is None
    hit = Play(0.0, Gesture((Segment(0.0, 0.01, 1.0),), 0.2), string="E4")
    begun = effect.watch(replace_moment(model, {}, GRID, fresh=[hit]), quiet)
    assert begun is not None
    assert (begun.wanted, begun.until, list(begun.bounds)) == ({"B3", "E4"}, {"": GRID + round(0.15 * FS)}, [])
    moved = effect.watch(replace_moment(model, {}, GRID, moved=["E4"]), quiet)
    assert moved is not None
    assert (moved.wanted, dict(moved.until)) == ({"B3", "E4"}, begun.until)
    # until 3,664 nothing more is looked at, then at the next of 15
    on = Switching(moved.wanted, until=moved.until)
    assert effect.watch(replace_moment(model, {}, 45 * GRID), on) is None
    assert effect.watch(replace_moment(model, {}, 58 * GRID), on) is None
    late = effect.watch(replace_moment(model, {}, 60 * GRID), on)
    assert late is not None
    assert late.wanted == frozenset()
    # strings that were switched off by hand come back while motion spreads
    some = effect.watch(replace_moment(model, {}, 45 * GRID), Switching(frozenset({"E4"}), until=moved.until))
    assert some is not None
    assert some.wanted == {"B3", "E4"}
    assert effect.load("E4") == sum(
        model.system.compiled[model.system.slot(f"E4.{p}")].potentials["E4"].weights.shape[1] for p in "zy"
    )
    assert effect.why(EffectUsage(1.0, {}, {}), "E4") == "from a gesture until the missing sound is below -80 dB"
    assert effect.budget == pytest.approx(effect.share * 1e-4)


@pytest.mark.parametrize(
    ("few", "levels", "on", "wanted"),
    [
        (True, (0.5, 0.49), (), ()),
        (True, (0.5, 0.51), (), ("B3", "E4")),
        (True, (0.5, 0.41), ("E4", "B3"), ("B3", "E4")),
        (True, (0.5, 0.39), ("E4", "B3"), ()),
        (False, (0.7, 0.7), (), ()),
        (False, (0.75, 0.7), (), ("B3",)),
        (False, (0.6, 0.6), ("B3",), ()),
        (False, (0.7, 0.6), ("B3",), ("B3",)),
        (False, (1.1, 1.2), (), ("B3", "E4")),
    ],
)
def test_levels_of_phantom_partials_add_up_or_in_power(
    few: bool,
    levels: tuple[float, float],
    on: tuple[str, ...],
    wanted: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of few strings the sum is below the budget, of keys the root of the sum of squares; 0.9 of it where they run."""
    model, effect = phantoms()
    level = dict(zip(("B3", "E4"), levels, strict=True))
    monkeypatch.setattr(effect, "_levels", lambda at, peak: {name: level[name] * effect.budget for name in level})
    monkeypatch.setattr(effect, "_few", few)
    found = effect.watch(replace_moment(model, {}, 15 * GRID), Switching(frozenset(on)))
    assert found is not None
    assert found.wanted == set(wanted)
    assert {(name, left_out) for name, _, left_out in found.bounds} == {(n, n not in wanted) for n in level}


def test_a_bound_of_phantom_partials_is_that_of_the_motion() -> None:
    """Four times as much for twice the motion, half for twice the loudest sample, infinite where modes have left."""
    model, effect = phantoms()
    small, large = shaken(model, 9, 1e-7), shaken(model, 9, 2e-7)
    one, two = (effect._levels(replace_moment(model, {}, state=s), np.ones(1)) for s in (small, large))
    assert {name: 4 * level for name, level in one.items()} == pytest.approx(two)
    half = effect._levels(replace_moment(model, {}, state=small), np.full(1, 2.0))
    assert {name: level / 2 for name, level in one.items()} == pytest.approx(half)
    assert all(0.0 < level < math.inf for level in one.values())
    for name, level in one.items():
        bound, system = effect._bounds[name, 0.0], model.system
        bases = {c: system.compiled[system.slot(c)].basis for c in bound.parts}
        moved = {c: to_motion(basis, system.modes_of(small, c)) for c, basis in bases.items()}
        squares = sum(
            (part.displaced @ moved[c][0]) ** 2 + (part.moving @ moved[c][1]) ** 2 for c, part in bound.parts.items()
        )
        s = np.sqrt(squares)
        assert level == pytest.approx(max(s @ M @ s for M in bound.heard))
    # modes that a bend has moved beyond half the sampling rate are in no bound
    fewer = model.system.compiled[model.system.slot("E4.z")].basis
    gone = model.system.with_basis("E4.z", fewer.select(np.arange(fewer.n_modes) < fewer.n_modes - 1))
    left = effect._levels(replace(replace_moment(model, {}, state=small), system=gone), np.ones(1))
    assert (left["B3"], left["E4"]) == (pytest.approx(one["B3"]), math.inf)
    assert effect._alike("E4") == "E4"
    effect.prepare(Timeline([], [Play(0.0, Gesture(()), string="B3")]))
    assert ("B3", 0.0) in effect._bounds


# -- sidebands ---------------------------------------------------------------------------------------------------------


def test_heights_of_sidebands_by_their_formulas(model: Model) -> None:
    """F / F_n and A / A_n of the module for single pairs, with the partials that they drive through the bridge."""
    system, response = model.system, BridgeResponse(model)
    basis = system.compiled[system.slot("E4.z")].basis
    held = HeldModes.of(basis, "bridge")
    found = Plane.of("E4.z", basis, held, system, response)
    w, g, s = held.freq_rad, held.force, held.damping_rate
    i, end = response.components.index("E4.z"), basis.index("bridge")
    low = held.vectors[:12]
    form = (low * np.asarray(stretch_weights(basis))) @ low.T
    ratios = [abs(form[j, k]) / math.sqrt(form[j, j] * form[k, k]) for j, k in itertools.permutations(range(12), 2)]
    single = min(32, len(w))
    assert found.bent.shape == (single, basis.n_modes)
    np.testing.assert_allclose(found.bent, (held.vectors * held.stiffness / w[:, None])[:single])
    np.testing.assert_allclose(found.bridge_force, (g / w) @ (held.vectors * held.stiffness / w[:, None]))
    for n, m in ((0, 3), (2, 2), (5, 1), (7, 11)):
        total = 0.0
        for side in (-1.0, 1.0):
            freq = abs(w[n] + side * 2 * w[m])
            if n == m and side < 0:
                continue
            away = max(abs(w[n] ** 2 - freq**2), 2 * freq * (0.0012 * freq + s[n]))
            bridge = freq**2 / away
            k = int(np.argmin(np.abs(w - freq)))
            mobility = np.interp(w[k], response.freq_rad, response.mobility[i]) + w[k] * abs(basis.residual[end, end])
            shift = g[k] ** 2 * mobility / (2 * w[k] ** 2)
            apart = abs(freq - w[k]) - 0.0012 * w[k] - shift
            driven = (bridge * shift + 0.5 * max(ratios) * w[k]) / max(s[k] + s[n] + 2 * s[m], apart)
            total += response.heard_at("E4.z", np.array([freq]))[0, 0] * (bridge + driven) * g[n] / w[n]
        assert found.heard[0, n, m] == pytest.approx(total, rel=1e-9)
    top = response.heard[0, i].max()
    np.testing.assert_allclose(found.heard[0, :, -1], (top * (g / w) * (2 + w / w[0]))[:single], rtol=1e-9)
    np.testing.assert_allclose(found.stopped, response.stopped_at("E4.z", response.freq_rad[:1])[:, 0])
