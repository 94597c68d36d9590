"""Every shortcut of the kernel, switched off by itself: the same samples, and the other way is really taken."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from nonlinear_scenes import LENGTH, body, hang, held_string, modulated_guitar
from nonlinear_scenes import drawn as drawn_guitar

from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact, HardeningSpring
from tonewood.physics.coupling.system import Drive, Readout, System
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts

DT = 1 / 48000
PAGE = Path(__file__).parents[4] / "docs" / "kernel.md"
NAMES = [field.name for field in fields(Shortcuts)]
#: shortcuts that skip work without another order of operations change no bit
EXACT = {"block_culling", "group_bound", "fine_bound"}
#: takes effect where connections are solved in parts: tests/unit/physics/coupling/test_inverse.py
ELSEWHERE = {"at_rest"}
FRETS = {f"f{k}": LENGTH / 2 ** (k / 12) for k in range(1, 7)}


def linear_guitar(extra=(), frets=True, drives=()):
    """Two strings over six frets, or none, on a body; `drives` of a second body, which hears them."""
    places = FRETS | {"pluck": 0.11 * LENGTH, "bridge": 0.013 * LENGTH}
    components = {f"s{i}": held_string(40, places, density=(1 + i) * 1e-3, damping=0.5) for i in range(2)}
    components["body"] = body(["b0", "b1"])
    connections = [Connection(f"joint{i}", (Term(f"s{i}", "bridge"), Term("body", f"b{i}", -1.0))) for i in range(2)]
    connections += [
        Connection(f"s{i}{fret}", (Term(f"s{i}", fret),), Contact(1e10, 1.8, 0.2, offset=-3e-4 - 1e-4 * i))
        for i in range(2)
        for fret in FRETS
        if frets
    ]
    connections += extra
    if drives:
        components["heard"] = body(["b0", "b1"])
    readouts = [
        Readout("a", "acceleration", (Term("body", "b0"),)),
        Readout("u", "displacement", (Term("s1", "pluck"),)),
    ]
    return System.build(components, connections, readouts, dt=DT, drives=drives)


def drawn(system, height):
    """Strings let go while another force draws the second one."""
    state = system.start()
    hang(system, state, "s0", height, 0.11 * LENGTH)
    basis = system.compiled[system.slot("s1")].basis
    return state, compile_force("s1", basis, "pluck", [Segment(0.0, 60 * DT, 0.0, 2e2)], DT, time=10.3 * DT)


def spring_on(component, place):
    """Give a linear law that is stepped with the nonlinear ones."""
    return Connection(f"spring {component} {place}", (Term(component, place),), HardeningSpring(2e3, damping=0.5))


def run(system, state, injections, **off):
    """Samples, forces and final modes; with shortcuts switched off."""
    stepper, state = KernelStepper(system, shortcuts=Shortcuts(**off)), state.copy()
    out, forces = stepper.run(state, 640, injections)
    assert stepper.statistics.failures == stepper.statistics.redone == 0
    return (out, forces, state.modes), stepper


def scenes():
    """Strings alone, far from their frets, at them, with linear laws; strings under rising tension, the same."""
    alone = linear_guitar(frets=False)
    yield "alone", alone, *drawn(alone, 8e-4)
    springs = [spring_on("body", "b0"), spring_on("body", "b1"), spring_on("s0", "pluck")]
    for name, extra, height in (("far", [], 3e-5), ("near", [], 8e-4), ("springs", springs, 3e-5)):
        system = linear_guitar(extra)
        yield name, system, *drawn(system, height)
    # a law and a linear connection drive one point
    drives = [Drive("heard", "b0", name) for name in ("joint0", "spring body b0")]
    driven = linear_guitar([spring_on("body", "b0")], drives=drives)
    yield "springs that are heard", driven, *drawn(driven, 3e-5)
    for name, system in (
        ("tension", modulated_guitar()),
        ("tension and frets", modulated_guitar(frets=Contact(1e10, 1.8, offset=-1e-3))),
        ("tension and a spring", modulated_guitar(extra=[spring_on("body", "b0")])),
    ):
        yield name, system, drawn_guitar(system, 5.0), []
    # a fret that was culled when the block began is touched in it
    system = modulated_guitar(extra=[spring_on("body", "b0")], frets=Contact(1e10, 1.8, offset=-1.2e-3))
    yield "tension, frets and a spring", system, drawn_guitar(system, 2.0), []


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ELSEWHERE])
def test_switched_off_by_itself_gives_the_same_samples(name):
    changed = []
    for scene, system, state, injections in scenes():
        ours, _ = run(system, state, injections)
        theirs, _ = run(system, state, injections, **{name: False})
        for a, b in zip(ours, theirs, strict=True):
            # a contact that is not culled takes linear laws to the general solve
            if name in EXACT and "spring" not in scene:
                np.testing.assert_array_equal(a, b)
            np.testing.assert_allclose(a, b, atol=1e-9 * np.abs(b).max(), rtol=0, err_msg=scene)
            changed.append(not np.array_equal(a, b))
    # another order of operations shows in some bits: the switch does something
    assert name in EXACT or any(changed)


@pytest.mark.parametrize("name", ["springs", "tension and a spring"])
def test_linear_laws_in_pieces_are_the_same_bits(name):
    system, state, injections = next(scene[1:] for scene in scenes() if scene[0] == name)
    (whole, forces, modes), _ = run(system, state, injections)
    stepper, state = KernelStepper(system), state.copy()
    pieces = [stepper.run(state, n, injections) for n in (64, 192, 384)]
    np.testing.assert_array_equal(np.concatenate([out for out, _ in pieces]), whole)
    np.testing.assert_array_equal(np.concatenate([f for _, f in pieces]), forces)
    np.testing.assert_array_equal(state.modes, modes)


def test_culling_reads_fewer_rows_with_each_bound():
    system = linear_guitar()
    state, injections = drawn(system, 2e-4)
    read = {
        name: run(system, state, injections, **{name: False})[1].culling_statistics["rows_read"]
        for name in ("block_culling", "fine_bound", "linear_laws")
    }
    assert 0 < read["linear_laws"] < read["fine_bound"] <= read["block_culling"]


def test_every_shortcut_has_a_section():
    text = PAGE.read_text(encoding="utf-8")
    assert sorted(re.findall(r"^### `(\w+)`", text, re.MULTILINE)) == sorted(NAMES)
