"""Partials and decays of strings of any plugin against their own law, by the dense eigenproblem of the held string."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import tonewood as tw
import tonewood.authoring as ta
from tonewood.cli.main import run
from tonewood.instrument.inspection import string_laws
from tonewood.instrument.inspection.string_laws import LawErrors, law_errors
from tonewood.instrument.model.assembly import Model, assemble

Floats = np.ndarray
PLUGIN = '''
import numpy as np
import tonewood.authoring as ta


class PowerParameters(ta.Parameters):
    """Of the string."""

    length: float = ta.quantity("m", low=0.02, high=5.0, doc="between nut and bridge")
    tension: float = ta.quantity("N", low=1.0, high=2000.0, doc="of the open string")
    linear_density: float = ta.quantity("kg/m", low=1e-5, high=0.1, doc="mass per length")
    b: float = ta.quantity("1", low=0.0, high=1.0, doc="times omega^p")
    p: float = ta.quantity("1", low=0.0, high=2.0, default=0.5, doc="power")
    error: float = ta.quantity("1", low=0.0, high=1.0, default=0.0, doc="of the frequencies of a detuned basis")


class PowerString(ta.Resonator[PowerParameters]):
    """sigma = b omega^p."""

    api = 1
    Parameters = PowerParameters
    length = property(lambda self: self.parameters.length)
    tension = property(lambda self: self.parameters.tension)

    def sigma(self, omega):
        return self.parameters.b * omega**self.parameters.p

    def eta(self, omega, k, tension=None):
        return 2 * self.sigma(omega) / omega

    def basis(self, freq_upper, *, stop=0.0, tension=None):
        p = self.parameters
        tension = p.tension if tension is None else tension
        return ta.string_basis(p.length - stop, tension, p.linear_density, 0.0, self.eta, freq_upper=freq_upper)

    def detuned(self, basis, tension):
        return ta.string_detuned(basis, tension, self.eta)

    def transfer(self, old, new):
        return ta.string_transfer(old, new)


class AtModes(PowerString):
    """Rates of the law at the modes' own frequencies: those of no partial."""

    def detuned(self, basis, tension):
        freq_rad = np.sqrt(tension * basis.metadata["tension_part"])
        return ta.retuned(basis, freq_rad, self.sigma(freq_rad), {"tension": tension})


class Mistuned(PowerString):
    """The third mode is off."""

    def detuned(self, basis, tension):
        right = super().detuned(basis, tension)
        wrong = np.sqrt(right.stiffness)
        wrong[2] *= 1 + self.parameters.error
        return ta.retuned(right, wrong, right.damping_rate, {})


class Unsaid(PowerString):
    """Modes of its own with rates at their own frequencies; nothing tells the law."""

    def basis(self, freq_upper, *, stop=0.0, tension=None):
        made = super().basis(freq_upper, stop=stop, tension=tension)
        freq_rad = np.sqrt(made.stiffness)
        changes = {"loss_error": None}
        return ta.retuned(made, freq_rad, self.sigma(freq_rad), changes)


class Said(Unsaid):
    """The same, which tells its law."""

    def decay_rate(self, freq_rad, tension):
        return self.sigma(freq_rad)


class OwnModes(Unsaid):
    """The same, mended."""

    def basis(self, freq_upper, *, stop=0.0, tension=None):
        return ta.with_partial_decays(super().basis(freq_upper, stop=stop, tension=tension), self.sigma)
'''


def bundle(folder: Path, kind: str, **values: float) -> Path:
    """A copy of the monochord with such a string."""
    source = tw.list_instruments()["monochord"]
    target = folder / "lyre"
    shutil.copytree(source, target, dirs_exist_ok=True)
    (target / "power.py").write_text(PLUGIN)
    yaml = YAML()
    manifest = yaml.load((source / "instrument.yaml").read_text())
    manifest["strings"]["A2"] = {
        "plugin": f"power.py:{kind}", "note": "A2", "end": "body.bridge", "length": 0.9, "tension": 58.8,
        "linear_density": 1.5e-3, "b": 0.02, **values,
    }  # fmt: skip
    with (target / "instrument.yaml").open("w") as stream:
        yaml.dump(manifest, stream)
    return target


def measured(folder: Path, kind: str, **values: float) -> tuple[Model, list[LawErrors]]:
    model = assemble(tw.load_instrument(bundle(folder, kind, **values), allow_code=True), 24000)
    return model, law_errors(model, "A2")


def held(basis: ta.ModalBasis, count: int) -> tuple[Floats, Floats]:
    """Frequencies (rad/s) and decay rates of partials with the bridge held: the modes without that motion, solved."""
    bridge = basis.right[basis.index("bridge")].real
    q, _ = np.linalg.qr(np.column_stack([bridge, np.eye(len(bridge))[:, :-1]]))
    free = q[:, 1:]
    squared, vectors = np.linalg.eigh((free.T * basis.stiffness) @ free)
    damping = np.einsum("ij,ij->j", vectors, ((free.T * basis.damping_rate) @ free) @ vectors)
    return np.sqrt(squared[:count]), damping[:count]


@pytest.mark.parametrize(("p", "b"), [(1.0, 1e-4), (0.5, 0.02), (1.5, 1e-6)])
def test_the_guide_s_recipe_keeps_the_law_and_rates_at_the_modes_do_not(tmp_path: Path, p: float, b: float) -> None:
    model, errors = measured(tmp_path, "PowerString", p=p, b=b)
    assert not any(e.decay_is_off or e.pitch_is_off for e in errors)
    freq_rad, rate = held(next(iter(model.strings["A2"].bases().values())), 20)
    np.testing.assert_allclose(rate, b * freq_rad**p, rtol=1e-3)
    model, errors = measured(tmp_path, "AtModes", p=p, b=b)
    freq_rad, rate = held(next(iter(model.strings["A2"].bases().values())), 20)
    error = rate / (b * freq_rad**p) - 1
    assert np.abs(error).max() > 0.04
    assert errors[0].decay_is_off
    assert errors[0].decay_partial == 1 + np.abs(error).argmax()
    assert errors[0].decay == pytest.approx(error[errors[0].decay_partial - 1], rel=1e-2)


def test_frequencies_are_compared_too(tmp_path: Path) -> None:
    _, errors = measured(tmp_path, "Mistuned", error=2e-3)
    assert errors[0].pitch_is_off
    assert errors[0].pitch_partial in (2, 3)
    assert not any(e.pitch_is_off for e in measured(tmp_path, "Mistuned", error=0.0)[1])


def test_a_law_that_nobody_tells_is_not_compared(tmp_path: Path) -> None:
    assert all(e.decay is None for e in measured(tmp_path, "Unsaid")[1])
    said = measured(tmp_path, "Said", p=1.0, b=1e-4)[1]
    assert said[0].decay_is_off
    assert said[0].own == pytest.approx(said[0].decay, abs=1e-3)
    mended = measured(tmp_path, "OwnModes", p=1.0, b=1e-4)[1]
    assert not any(e.decay_is_off for e in mended)
    assert abs(mended[0].decay or 1.0) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("PowerString", "decays within 0.00"),
        ("AtModes", "warning: string A2: partial 1 at stop 0 decays at 0."),
        ("Unsaid", "its plugin does not tell its loss law (`decay_rate`): decays are not compared"),
    ],
)
def test_check_names_the_string_with_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, said: str
) -> None:
    folder = bundle(tmp_path, kind)
    with pytest.raises(SystemExit, match="0"):
        run(["check", str(folder), "--allow-code", "--all"])
    out = capsys.readouterr().out
    assert said in out
    assert out.endswith("ok, with 1 warning\n" if kind == "AtModes" else "ok\n")
    with pytest.raises(SystemExit, match="0"):
        run(["check", str(folder), "--allow-code", "--json"])
    law = json.loads(capsys.readouterr().out)["strings"]["A2"]["law"]
    assert [(row["stop"], row["bend_cents"]) for row in law] == [(0, 0.0), (24, 0.0), (0, 200.0)]
    assert [row["decay_is_off"] for row in law] == [kind == "AtModes"] * 3


def test_a_basis_of_another_maker_is_refused_in_words() -> None:
    own = ta.ModalBasis.real([100.0, 200.0], [1.0, 1.0], {"bridge": [1.0, 1.0]})
    with pytest.raises(ValueError, match="was not made by string_basis"):
        ta.string_detuned(own, 10.0, lambda omega, k, tension: 0 * omega)


def test_a_loss_that_the_law_does_not_have_is_an_infinite_error() -> None:
    found = string_laws._relative(np.array([2.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(found, [1.0, np.inf, 0.0])
