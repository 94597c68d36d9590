"""The assembled model: joints and their factors, readouts, inputs, and physics that must follow."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sla

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.coupling.connections import Rigid, SpringDashpot, Term
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

Make = Callable[..., Instrument]
FS = 16000.0


@pytest.fixture
def model(make: Make) -> Model:
    return assemble(make(), FS)


def test_names_and_joints(model: Model) -> None:
    assert model.system.names == ("body", "A2.z", "A2.y", "D3.z")
    joints = {c.name: c for c in model.system.connections}
    c, s = math.cos(math.radians(12)), math.sin(math.radians(12))
    # the end of a polarization p follows (p . z) times the bridge: p = (0, sin, cos) and (0, cos, -sin)
    assert joints["A2.z.bridge"].terms == (Term("A2.z", "bridge"), Term("body", "bridge", pytest.approx(-c)))
    assert joints["A2.y.bridge"].terms == (Term("A2.y", "bridge"), Term("body", "bridge", pytest.approx(s)))
    assert joints["D3.z.bridge"].terms == (Term("D3.z", "bridge"), Term("body", "bridge", -1.0))
    assert all(isinstance(joints[f"{n}.bridge"].law, Rigid) for n in ("A2.z", "A2.y", "D3.z"))
    assert joints["A2.y.hold"].law == SpringDashpot(0.0, 0.0)
    assert model.inputs == {"body.bridge": (("body", "bridge", 1.0),), "body.wing": (("body", "wing", 1.0),)}
    assert (model.default_exciter, model.place("A2").length) == ("pluck", pytest.approx(0.65))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.validate) if n == "grand_piano" else n for n in sorted(tw.list_instruments())],
)
def test_every_connection_and_component_names_its_string_and_part(name: str) -> None:
    """Fields and names agree, which are made apart: names by each plugin, fields by the assembly."""
    model = assemble(tw.load_instrument(name), 12000.0)
    parts = {*model.instrument.attachments, *model.exciters, "finger"}
    for c in model.system.connections:
        string, second, *_ = c.name.split(".")
        expected = {"bridge": "", "hold": "", "attached": second}
        assert (c.owner, c.part) == (string, expected[c.role])
        assert c.role == "attached" or c.name.endswith(f".{c.role}")
        assert c.role != "attached" or c.part in parts
    system = model.system
    assert system.layout.owners == {n: n.split(".")[0] for n in system.names if n.split(".")[0] in model.strings}


def test_an_exciter_may_be_called_finger_beside_a_soft_finger(make: Make, values: dict[str, Any]) -> None:
    values["stops"]["model"] = "finger"
    touch = {"plugin": "stopping_finger", "touch": {"fraction": 0.5}, "from_bridge": 0.1}
    values["exciters"]["finger"] = touch
    names = {c.name for c in assemble(make(values), FS).system.connections if c.part == "finger"}
    assert {"D3.finger.skin1", "D3.finger.skin11"} <= names


def test_directions_without_data_are_rigid(make: Make) -> None:
    model = assemble(make().replace({"strings.A2.tilt_deg": 0}), FS)
    joints = {c.name: c for c in model.system.connections}
    assert joints["A2.y.bridge"].terms == (Term("A2.y", "bridge"),)


def test_an_inclined_string(make: Make) -> None:
    angle = math.radians(23.6)
    changes = {"strings.D3.axis": [math.cos(angle), 0, -math.sin(angle)]}
    joints = {c.name: c for c in assemble(make().replace(changes), FS).system.connections}
    assert joints["D3.z.bridge"].terms[1].factor == pytest.approx(-math.cos(angle))


def test_two_directions_at_one_end(make: Make, values: dict[str, Any]) -> None:
    values["body"]["points"]["wing"]["direction"] = "y"
    values["strings"]["A2"]["end"] = ["body.bridge", "body.wing"]
    joints = {c.name: c for c in assemble(make(values), FS).system.connections}
    c, s = math.cos(math.radians(12)), math.sin(math.radians(12))
    assert [t.factor for t in joints["A2.z.bridge"].terms] == pytest.approx([1.0, -c, -s])
    assert [t.factor for t in joints["A2.y.bridge"].terms] == pytest.approx([1.0, s, -c])


def test_outputs(make: Make) -> None:
    default = assemble(make(), FS).outputs
    assert [g.name for g in default] == ["bridge"]
    assert (default[0].unit, default[0].full_scale, default[0].quantity) == ("m/s^2", 500, "acceleration")
    both = assemble(make(), FS, outputs=["wing", "bridge"])
    assert [g.name for g in both.outputs] == ["wing", "bridge"]
    for group in both.outputs:
        assert [both.system.readouts[i].name for i in group.readouts] == [f"{group.name}.{c}" for c in group.channels]
    with pytest.raises(BundleError, match="outputs: there is no output 'drum'; there are bridge, wing"):
        assemble(make(), FS, outputs=["drum"])


def test_no_mode_above_the_limit(make: Make) -> None:
    model = assemble(make(), 4000.0)
    assert all(c.basis.natural_freq.max() < 0.45 * 4000 for c in model.system.compiled)


def test_room_for_every_stop(model: Model) -> None:
    for string in model.strings.values():
        for stop in (0, 1, 12):
            for name, basis in string.bases(stop, bend_cents=-200).items():
                assert basis.n_modes <= model.system.layout.capacities[model.system.slot(name)]
                model.system.with_basis(name, basis)


def test_power_passes_the_bridge_whole(model: Model) -> None:
    """Undamped parts, any tilt: the energy that leaves the strings enters the body, to rounding."""
    instrument = model.instrument.replace(
        {"strings.*.loss": {"law": "sigma", "sigma0": 0.0}, "strings.*.end_compliance": 1e-7}
    )
    system = assemble(instrument, FS).system
    state, rng = system.start(), np.random.default_rng(3)
    for name in ("A2.z", "A2.y"):
        modes = system.modes_of(state, name)
        modes[:] = 1e-4 * rng.standard_normal(modes.shape) / (1 + np.arange(modes.shape[1])) ** 2
    # consistent at the start: the bridge is at rest and so are the strings' ends
    for name in ("A2.z", "A2.y"):
        compiled = system.compiled[system.slot(name)]
        rows = compiled.form.rows("displacement", np.array([compiled.basis.index("bridge")]))[0]
        fast = compiled.form.rows("velocity", np.array([compiled.basis.index("bridge")]))[0]
        modes = system.modes_of(state, name)
        flat, both = modes.T.reshape(-1), np.stack([rows.reshape(-1), fast.reshape(-1)])
        flat -= both.T @ sla.solve(both @ both.T, both @ flat)
        modes[:] = flat.reshape(-1, 2).T
    energy = lambda: _energy(system, state)  # noqa: E731
    start = energy()
    _, forces = NumpyStepper(system).run(state, 400)
    assert np.abs(forces).max() > 1e-3
    lost = start - energy()
    assert 0 < lost < 0.2 * start  # to the damped body alone, and to the joint's own compliance
    _, forces = NumpyStepper(system).run(state, 400)
    assert energy() < start - lost


def _energy(system: Any, state: Any) -> float:
    """Energy of mass-normalised real modes: q = 2 Re z, q' = 2 Re lambda z."""
    total = 0.0
    for name in system.names:
        basis, z = system.compiled[system.slot(name)].basis, system.modes_of(state, name)
        z = z[0] + 1j * z[1]
        total += float(np.sum((2 * (basis.poles * z).real) ** 2 + basis.stiffness * (2 * z.real) ** 2)) / 2
    return total


def test_points_on_strings(make: Make, values: dict[str, Any]) -> None:
    values["strings"]["A2"]["points"] = {"pick": {"from_bridge": {"fraction": 0.2}}}
    values["outputs"][0] = {
        "name": "pick", "plugin": "point_pickup", "quantity": "velocity", "at": "A2.pick", "full_scale": 1.0,
    }  # fmt: skip
    model = assemble(make(values), FS)
    assert model.system.compiled[1].basis.places["pick"] == pytest.approx(0.13)
    values["strings"]["A2"]["points"] = {"pick": {"from_bridge": 0.5}}
    with pytest.raises(
        BundleError, match=r"strings\.A2\.points\.pick: lies 0\.5 m from the bridge; .* \(the last stop\)"
    ):
        assemble(make(values), FS)
    values["strings"]["A2"]["points"] = {"pluck": {"from_bridge": 0.1}}
    with pytest.raises(BundleError, match="other than bridge and pluck"):
        assemble(make(values), FS)


def test_a_struck_body_does_not_ring_at_nyquist() -> None:
    """Velocities that do not fit together leave an alternating force; the seats' compliance and the strings end it."""
    system = assemble(Instrument.load("classical_guitar"), 48000.0, outputs=["bridge"]).system
    state = system.start()
    body = system.modes_of(state, "body")
    body[:] = 1e-6 * np.random.default_rng(5).standard_normal(body.shape)
    stepper, high = KernelStepper(system), []
    for _ in range(4):
        _, forces = stepper.run(state, 4800)
        spectrum = np.abs(np.fft.rfft(forces[:, :12] * np.hanning(4800)[:, None], axis=0))
        high.append(spectrum[-200:].max() / spectrum.max())
    assert high[0] > 1e-2
    assert high[3] < 1e-6


def test_seats_do_not_detune(make: Make) -> None:
    """The seat's compliance lengthens the string by T R: well under 0.02 cent, alike for every partial."""
    from system_modes import coupled_modes

    freqs = []
    for compliance in (0.0, 2e-8):
        changes = {"strings.*.end_compliance": compliance, "tuning.compensate": "none"}
        model = assemble(make().replace(changes), FS)
        joints = [c for c in model.system.connections if c.name == "D3.z.bridge"]
        parts = {n: model.system.compiled[model.system.slot(n)].basis for n in ("body", "D3.z")}
        modes = coupled_modes(parts, joints)
        freqs.append(modes.freq[modes.dominated_by("D3.z")][:15])
    shift = 1200 * np.log2(freqs[1] / freqs[0])
    assert (shift <= 1e-9).all()
    expected = -1200 / math.log(2) * 71.2 * 2e-8 / 0.65
    np.testing.assert_allclose(shift[8:], expected, rtol=0.1)
    assert np.abs(shift).max() < 0.02
