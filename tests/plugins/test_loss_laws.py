"""Loss laws, installed ones and such in a bundle's folder; and strings that state nothing but their physics."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
import tonewood.authoring as ta
from tonewood.errors import BundleError, PluginError
from tonewood.instrument.bundle.json_schema import bundle_schema
from tonewood.instrument.contract.registry import check_plugin, plugin
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.report.parameters import parameters

Floats = NDArray[np.float64]

LAW = '''
import tonewood.authoring as ta


class HalfParameters(ta.Parameters):
    """Of the law."""

    b: float = ta.quantity("1", low=-1.0, high=1.0, doc="sigma at 1 rad/s, 1/s")


class Half(ta.Loss[HalfParameters]):
    """sigma = b omega^(1/2)."""

    api = 1
    Parameters = HalfParameters

    def eta(self, omega, k, string):
        return 2 * self.parameters.b * omega**-0.5
'''
LOSS = {"law": "half.py:Half", "b": 0.02}


@pytest.fixture
def lyre(tmp_path: Path) -> Path:
    """A copy of the monochord with a loss law in its folder."""
    folder = tmp_path / "lyre"
    shutil.copytree(tw.list_instruments()["monochord"], folder)
    (folder / "half.py").write_text(LAW)
    return folder


def with_law(folder: Path, loss: dict[str, Any] | str, *, allow_code: bool = True) -> tw.Instrument:
    values: Any = load_yaml(folder / "instrument.yaml", error=BundleError)
    values["strings"]["A2"]["loss"] = loss
    return tw.Instrument.from_values(values, folder, allow_code=allow_code)


def test_partials_decay_by_a_law_in_the_bundles_folder(lyre: Path) -> None:
    string = with_law(lyre, LOSS).resonators["A2"]
    held = HeldModes.of(string.basis(8000.0), "bridge")
    n = held.n_modes // 2
    np.testing.assert_allclose(held.damping_rate[:n], 0.02 * np.sqrt(held.freq_rad[:n]), rtol=1e-3)
    rates = string.decay_rate(held.freq_rad, string.tension)
    assert rates is not None
    np.testing.assert_allclose(rates, 0.02 * np.sqrt(held.freq_rad), rtol=1e-12)


def test_its_code_runs_only_when_that_is_allowed(lyre: Path) -> None:
    with pytest.raises(BundleError, match=r"strings\.A2\.loss\.law: the bundle holds code, half\.py"):
        with_law(lyre, LOSS, allow_code=False)


def test_a_changed_law_is_another_instrument(lyre: Path) -> None:
    """Its source is part of the hash under which tunings and renders are kept."""
    before = with_law(lyre, LOSS)
    assert "half.py:Half" in before.plugin_hashes
    values, text = before.resolved["strings"]["A2"]["loss"], (lyre / "half.py").read_text()
    assert values == LOSS
    (lyre / "half.py").write_text(text.replace("omega**-0.5", "omega**-0.4"))
    after = with_law(lyre, LOSS)
    assert after.plugin_hashes["half.py:Half"] != before.plugin_hashes["half.py:Half"]
    assert {"sigma"} < set(with_law(lyre, {"law": "sigma", "sigma0": 1.0}).plugin_hashes)


@pytest.mark.parametrize(
    ("loss", "said"),
    [
        ("sigma", r"strings\.A2\.loss: is .*; a mapping with the key law"),
        ({"sigma0": 1.0}, r"strings\.A2\.loss\.law: is missing"),
        ({"law": 3}, r"strings\.A2\.loss\.law: is .*; the name of a loss law is wanted: sigma, valette, woodhouse"),
        ({"law": "sigmo"}, r"strings\.A2\.loss\.law: there is no plugin 'sigmo' of kind loss; did you mean sigma\?"),
        ({"law": "bow"}, r"strings\.A2\.loss\.law: plugin 'bow' is of kind exciter; one of kind loss is wanted"),
        ({"law": "sigma", "sigma0": -1.0}, r"strings\.A2\.loss\.sigma0: is -1 1/s; at least 0 1/s is allowed"),
        ({"law": "sigma", "sigma": 1.0}, r"strings\.A2\.loss\.sigma: is not a known key; did you mean sigma\d\?"),
        ({"law": "half.py:Half", "b": -0.1}, r"strings\.A2\.loss: Half\.eta returns eta = -\S+ at \S+ Hz; it must be"),
    ],
)
def test_a_wrong_law_is_named_in_one_line(lyre: Path, loss: Any, said: str) -> None:
    with pytest.raises(BundleError, match=rf"instrument\.yaml: (line \d+: )?{said}") as fault:
        with_law(lyre, loss).resonators["A2"].basis(4000.0)
    assert "\n" not in str(fault.value)


def test_a_single_number_of_a_law_can_be_replaced(lyre: Path) -> None:
    half = with_law(lyre, LOSS).replace({"strings.A2.loss.b": {"scale": 0.5}})
    assert half.resolved["strings"]["A2"]["loss"] == {"law": "half.py:Half", "b": 0.01}
    assert parameters(with_law(lyre, {"law": "sigma", "sigma0": 1.0}))["strings.A2.loss.sigma0"].unit == "1/s"


def test_strings_of_the_same_numbers_have_equal_parameters(lyre: Path) -> None:
    """By which effects tell strings that are alike."""
    one, two, other = (with_law(lyre, {**LOSS, "b": b}).resonators["A2"].parameters for b in (0.02, 0.02, 0.03))
    assert one == two
    assert hash(one) == hash(two)
    assert one != other


def test_editors_know_every_installed_law() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = bundle_schema()
    branches = {b["title"]: b for b in schema["$defs"]["StringPart"]["anyOf"]}
    loss = branches["stiff_string"]["properties"]["loss"]
    check = jsonschema.Draft202012Validator({**loss, "$defs": schema["$defs"]})
    assert check.is_valid({"law": "valette", "diameter": 1e-3, "delta_ve": 1e-3})
    assert check.is_valid({"law": "half.py:Half", "b": 1.0})
    assert not check.is_valid({"law": "sigma", "sigma0": -1.0})
    assert not check.is_valid({"law": "sigma", "eta_f": 1.0})
    assert not check.is_valid({"sigma0": 1.0})


class WireParameters(ta.Parameters):
    """Of the string."""

    b: float = ta.quantity("1", low=0.0, high=1.0, default=0.02, doc="of the loss")


class Wire(ta.Resonator[WireParameters]):
    """States its physics alone."""

    api = 1
    Parameters = WireParameters
    length, tension, linear_density, bending_stiffness = 0.65, 70.0, 4e-3, 6e-5

    def loss(self, omega: Floats, k: Floats, tension: float) -> Floats:
        """As `Half`."""
        return 2 * self.parameters.b * omega**-0.5


def test_a_string_is_made_of_its_physics() -> None:
    """The wave equation's partials at three tensions and two stops, their decays, and a motion carried over."""
    check_plugin(Wire, "wire")
    wire = Wire.from_values({})
    assert isinstance(wire, Wire)
    open_basis = wire.basis(9000.0)
    for stop, tension in ((0.0, 70.0), (0.0, 77.0), (0.2, 65.0)):
        basis = wire.detuned(wire.basis(9000.0, stop=stop), tension)
        held = HeldModes.of(basis, "bridge")
        k = np.arange(1, 11) * np.pi / (0.65 - stop)
        omega = np.sqrt((tension * k**2 + 6e-5 * k**4) / 4e-3)
        np.testing.assert_allclose(held.freq_rad[:10], omega, rtol=2e-4)
        np.testing.assert_allclose(held.damping_rate[:10], 0.02 * np.sqrt(omega), rtol=5e-3)
    short, q = wire.basis(9000.0, stop=0.2), np.linspace(1.0, 0.0, open_basis.n_modes)
    displacement, velocity = wire.transfer(open_basis, short)
    for carried, matrix in zip(wire.carried(open_basis, short, q, q), (displacement, velocity), strict=True):
        np.testing.assert_allclose(carried, matrix @ q, atol=1e-12)
    bridge = [b.right[b.index("bridge")].real for b in (open_basis, short)]
    assert bridge[1] @ displacement @ q == pytest.approx(bridge[0] @ q, rel=1e-9)


@pytest.mark.parametrize(
    ("taken", "said"),
    [
        ({"loss"}, "leaves out loss"),
        ({"linear_density"}, "leaves out linear_density"),
        ({"length", "loss"}, "leaves out length, loss"),
    ],
)
def test_a_string_that_states_too_little_is_refused(taken: set[str], said: str) -> None:
    body = {k: v for k, v in vars(Wire).items() if k in {"api", "Parameters", *_STATED} - taken}
    kind: Any = type("Less", (ta.Resonator,), body)
    with pytest.raises(PluginError, match=said):
        check_plugin(kind, "less")
    with pytest.raises(TypeError, match=r"leaves out|abstract"):
        kind.from_values({})


_STATED = ("length", "tension", "linear_density", "loss")


def test_a_string_with_modes_of_its_own_needs_all_that_they_need() -> None:
    body = {k: vars(Wire)[k] for k in ("api", "Parameters", "length", "tension")}
    made = plugin("stiff_string")
    with pytest.raises(PluginError, match="leaves out detuned, transfer"):
        check_plugin(type("Own", (ta.Resonator,), {**body, "basis": made.basis}), "own")  # type: ignore[attr-defined]  # of a resonator
    whole = {**body, **{name: getattr(made, name) for name in ("basis", "detuned", "transfer")}}
    kind: Any = type("Own", (ta.Resonator,), whole)
    check_plugin(kind, "own")
    assert kind.from_values({}).decay_rate(np.ones(3), 70.0) is None  # no law is stated
    with pytest.raises(BundleError, match=r"Wrong\.loss returns eta = -1 at"):
        type("Wrong", (Wire,), {"loss": lambda self, w, k, t: -np.ones_like(w)}).from_values({}).basis(4e3)  # type: ignore[attr-defined]
