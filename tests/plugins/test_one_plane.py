"""Strings that move in one plane, with the body moving in that plane, across it, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

FS = 24000
STRING = {
    "note": "G3", "length": 0.645, "tension": 133.9, "linear_density": 2.095e-3, "axial_stiffness": 10807.0,
    "loss": {"law": "sigma", "sigma0": 1.0}, "end": "body.bridge",
}  # fmt: skip
#: tables of a body: two modes, and one that lies above the highest that is stepped
BODIES = {2: "200,25,0.6,1\n310,30,0.5,-1\n", 0: "11500,30,0.5,1\n"}


def one_string(folder: Path, plugin: str, *, planes: list[str], direction: str, n_modes: int = 2) -> Instrument:
    """One string over a body whose only point moves in one direction."""
    (folder / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n" + BODIES[n_modes])
    points = {"bridge": {"direction": direction}}
    values = {
        "schema": "tonewood-instrument/2", "name": "plane", "title": "plane", "licence": "CC0-1.0", "sources": {},
        "provenance": {"*": {"kind": "authored"}},
        "body": {"plugin": "modal_table", "table": "body.csv", "shapes": "points", "points": points},
        "strings": {"S": {**STRING, "plugin": plugin, "polarizations": planes}},
        "stops": {"kind": "continuous", "count": 3},
        "exciters": {"pluck": {"plugin": "pluck_ramp", "from_bridge": 0.1}},
        "playing": {"velocity": {"parameter": "pluck.force", "low": 0.4, "high": 4.0}},
        "outputs": [{"name": "o", "plugin": "point_pickup", "quantity": "velocity", "at": "body.bridge",
                     "full_scale": 1.0}],
    }  # fmt: skip
    return Instrument.from_values(values, folder)


SCORE = tw.Score([tw.Note(0.0, 0.03, string="S", stop=0, force=3.0), tw.Note(0.02, 0.02, string="S", stop=2)])


@pytest.mark.parametrize("n_modes", [0, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("direction", ["x", "z"])
@pytest.mark.parametrize("planes", [["z"], ["y"]], ids="".join)
@pytest.mark.parametrize("plugin", ["phantom_string", "geometric_string", "tension_modulated_string"])
def test_any_plane_over_any_body_renders(
    tmp_path: Path, plugin: str, planes: list[str], direction: str, n_modes: int
) -> None:
    """With all effects, switched ones, and an account of energy: same samples, and the energy adds up."""
    played = one_string(tmp_path, plugin, planes=planes, direction=direction, n_modes=n_modes)
    options = {"fs": FS, "max_duration": 0.04}
    plain = tw.render(SCORE, played, effects="all", **options)
    assert np.isfinite(plain.samples).all()
    if plugin != "geometric_string":  # whose account takes seconds
        booked = tw.Renderer(SCORE, played, effects="all", energy=True, **options)
        assert np.array_equal(np.concatenate(list(booked.blocks())), plain.samples)
        trace = booked.energy
        assert abs(trace.residual).max() <= 1e-9 * sum(trace.stored.values()).max()
    tw.render(SCORE, played, effects="auto", **options)
    assert tw.plan(SCORE, played, **options).effects


@pytest.mark.parametrize("plugin", ["phantom_string", "geometric_string", "tension_modulated_string"])
def test_a_string_bent_until_no_mode_is_stepped_holds_the_bridge(tmp_path: Path, plugin: str) -> None:
    """Eight octaves up, as far as a wheel of MIDI goes, only its compliance is left of the string.

    The body's two modes are then those of M q'' + C q' + (K + 1/R) q = 0, R the compliance between them.
    """
    played = one_string(tmp_path, plugin, planes=["z"], direction="z")
    string = tw.Renderer(SCORE, played, fs=FS).engine.model.strings["S"].bases(bend_cents=9600.0)["S.z"]
    assert string.n_modes == 0
    score = tw.Score([tw.Note(0.0, 0.5, string="S", stop=0, force=3.0)], [tw.Control(0.05, "bend", 9600.0)])
    sound = tw.render(score, played, fs=FS, effects="all", max_duration=0.4, tail=0.0)
    heard = sound.samples[int(0.3 * FS) :, 0]
    omega, mass, shape = 2 * np.pi * np.array([200.0, 310.0]), np.array([0.6, 0.5]), np.array([1.0, -1.0])
    R = string.residual[string.index("bridge"), string.index("bridge")]
    free = np.sqrt(np.linalg.eigvals((np.diag(mass * omega**2) + np.outer(shape, shape) / R) / mass[:, None])) / (
        2 * np.pi
    )
    spectrum = np.abs(np.fft.rfft(heard * np.hanning(heard.size), 1 << 16))
    freq = np.fft.rfftfreq(1 << 16, 1 / FS)
    for below, above in ((0.0, 600.0), (600.0, FS / 2)):
        band = (freq >= below) & (freq < above)
        peak = freq[band][np.argmax(spectrum[band])]
        assert peak == pytest.approx(free[(free >= below) & (free < above)].item(), rel=0.01)


def test_body_moved_along_the_string_alone_sounds_of_phantoms(tmp_path: Path) -> None:
    """A string in y on a body that moves in z: only the longitudinal force reaches it, by the leverage."""
    sounds = {}
    for effects in ("all", "none"):
        played = one_string(tmp_path, "phantom_string", planes=["y"], direction="z")
        sounds[effects] = tw.render(SCORE, played, effects=effects, fs=FS, max_duration=0.06).samples
    assert np.abs(sounds["none"]).max() == 0.0
    assert np.abs(sounds["all"]).max() > 0.0


def test_kernel_and_numpy_agree_where_the_body_has_no_other_port(tmp_path: Path) -> None:
    model = assemble(one_string(tmp_path, "phantom_string", planes=["y"], direction="z"), FS)
    rng, results = np.random.default_rng(3), []
    start = model.system.start()
    slot = model.system.slot("S.y")
    n = model.system.compiled[slot].basis.n_modes
    first = 1e-5 * rng.standard_normal((2, n)) / np.arange(1, n + 1)
    for stepper in (NumpyStepper, KernelStepper):
        state = start.copy()
        model.system.modes_of(state, "S.y")[:] = first
        results.append(stepper(model.system).run(state, 200)[0][:, 0])
    scale = np.abs(results[0]).max()
    assert scale > 0.0
    assert np.abs(results[0] - results[1]).max() < 1e-9 * scale
