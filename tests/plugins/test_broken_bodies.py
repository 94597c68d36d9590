"""Bodies that would create energy, as bundles: refused, shown to explode if they were let through, or mended.

The bodies are truncated lists of complex modes of random masses, springs and dashpots; the complete ones are passive.
"""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg

import tonewood as tw
from random_bodies import DAMPING, body, static_compliance
from tonewood.cli.main import run
from tonewood.errors import BundleError, PassivityError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.base import Body, BodyPoint
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.passivity.basis import check_basis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.support.params import Parameters

FS = 48000
PORTS = ("low", "middle", "high")
STRINGS = {"E2": (80.0, 6e-3), "A3": (75.0, 1.1e-3), "E4": (70.0, 4e-4)}
ONE = body(2, DAMPING["medium"])
KEPT = ONE.truncated()
VALUES: dict[str, Any] = {
    "schema": "tonewood-instrument/2",
    "name": "broken",
    "title": "A body cut out of a larger one",
    "licence": "CC0-1.0",
    "sources": {},
    "body": {
        "plugin": "modal_table",
        "table": "body.csv",
        "shapes": "complex",
        "points": {name: {} for name in PORTS},
    },
    "strings": {
        "defaults": {
            "plugin": "stiff_string",
            "length": 0.65,
            "bending_stiffness": 5e-5,
            "loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4},
            "polarizations": ["z"],
            "freq_upper": 4000,
        },
        **{
            name: {"note": name, "tension": t, "linear_density": mu, "end": f"body.{port}"}
            for (name, (t, mu)), port in zip(STRINGS.items(), PORTS, strict=True)
        },
    },
    "tuning": {"compensate": "none"},
    "exciters": {
        "pluck": {"plugin": "pluck_ramp", "from_bridge": 0.1},
        "tap": {"plugin": "force_pulse", "at": "body.low"},
    },
    "outputs": [
        {"name": "bridge", "plugin": "point_pickup", "quantity": "velocity", "at": "body.low", "full_scale": 1.0}
    ],
}


def table(modes: tuple[NDArray[Any], ...], names: tuple[str, ...] = PORTS) -> str:
    poles, right, left = modes
    head = [f"{p}_{side}_{part}" for p in names for side in ("right", "left") for part in ("re", "im")]
    lines = [",".join(["f_Hz", "zeta", *head])]
    for k, s in enumerate(poles):
        row = [abs(s) / (2 * np.pi), -s.real / abs(s)]
        for p in range(len(names)):
            row += [right[p, k].real, right[p, k].imag, left[p, k].real, left[p, k].imag]
        lines.append(",".join(f"{x:.17g}" for x in row))
    return "\n".join(lines)


def bundle(folder: Path, **of_body: Any) -> Instrument:
    (folder / "body.csv").write_text(table(KEPT))
    values = copy.deepcopy(VALUES)
    residual = static_compliance(*ONE.modes) - static_compliance(*KEPT)
    values["body"] |= {"truncation": {"residual_compliance": residual.tolist()}, **of_body}
    return Instrument.from_values(values, folder)


def long_run(model: Model, system: System, seconds: float) -> NDArray[np.float64]:
    """Loudness of successive twentieths of a second after a tap on the body, strings on it."""
    stepper = KernelStepper(system)
    state = stepper.start()
    basis = system.compiled[system.slot("body")].basis
    strike = basis.left[basis.index("low")] * 1e-3  # an impulse of 1 mN s
    system.modes_of(state, "body")[:] = [2 * strike.real, 2 * strike.imag]
    n = FS // 20
    return np.array([np.abs(stepper.run(state, n)[0]).max() for _ in range(round(seconds * 20))])


def test_a_broken_body_is_refused_with_places_and_sizes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    instrument = bundle(tmp_path)
    with pytest.raises(PassivityError) as fault:
        assemble(instrument, FS)
    line = str(fault.value)
    assert "\n" not in line
    assert "instrument.yaml: body: body.csv: not passive" in line
    assert "`repair: passive`" in line
    # the place it names: there the mobility of the table draws power out of nothing, by the share it names
    band = re.search(r"worst ([\d.e+-]+) to ([\d.e+-]+|inf) Hz: ([\d.e+-]+) of \|Y\| at ([\d.e+-]+) Hz", line)
    assert band is not None
    low, high, size, worst = map(float, band.groups())
    assert low <= worst <= high
    w = 2 * np.pi * worst
    poles, right, left = KEPT
    mobility = sum(
        1j * w * (np.outer(r, x) / (1j * w - s) + np.outer(r, x).conj() / (1j * w - s.conj()))
        for s, r, x in zip(poles, right.T, left.T, strict=True)
    )
    smallest = linalg.eigvalsh(0.5 * (mobility + mobility.conj().T))[0]
    assert smallest < 0
    assert 0.2 * size < -smallest / np.sqrt(np.sum(np.abs(mobility) ** 2)) < 5 * size  # ports are scaled there

    # JSON is YAML
    (tmp_path / "instrument.yaml").write_text(json.dumps(dict(instrument.resolved)))
    with pytest.raises(SystemExit, match="2"):
        run(["check", str(tmp_path)])
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "mobility is negative in" in err


def test_let_through_it_explodes_and_mended_it_dies_away(tmp_path: Path) -> None:
    mended = assemble(bundle(tmp_path, repair="passive", max_change=0.5), FS)
    slot = mended.system.slot("body")
    good = mended.system.compiled[slot].basis
    poles, right, left = KEPT
    broken = ModalBasis.complex(
        poles, dict(zip(PORTS, right, strict=True)), dict(zip(PORTS, left, strict=True)), residual=good.residual
    )
    exploding = mended.system.with_compiled({"body": mended.system.compile("body", broken)})
    loud = long_run(mended, exploding, 2.0)
    assert loud[-1] > 100 * loud[0]
    quiet = long_run(mended, mended.system, 2.0)
    assert quiet[-1] < 0.2 * quiet[0]
    assert quiet.max() == quiet[0]


def test_a_mended_body_is_played_and_says_what_was_done(tmp_path: Path) -> None:
    instrument = bundle(tmp_path, repair="passive", max_change=0.5)
    notes = [tw.Note(0.0, 0.5, note=n, force=2.0) for n in (40, 57, 64)] + [tw.Note(0.2, 0.1, technique="tap")]
    renderer = tw.Renderer(tw.Score(notes), instrument, FS, max_duration=2.0)
    sound = np.concatenate(list(renderer.blocks()))
    assert np.isfinite(sound).all()
    halves = [np.sqrt(np.mean(sound[i * FS // 2 : (i + 1) * FS // 2] ** 2)) for i in range(4)]
    assert halves[3] < 0.5 * max(halves)
    (line,) = renderer.summary().warnings
    assert re.match(r"body: made passive: poles unchanged, .*residues moved [\d.]+%, mobility [\d.]+% \(H2\)", line)


def test_check_says_how_far_the_repair_moved_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mended = bundle(tmp_path, repair="passive", max_change=0.5)
    (tmp_path / "instrument.yaml").write_text(json.dumps(dict(mended.resolved)))
    with pytest.raises(SystemExit, match="0"):
        run(["check", str(tmp_path)])
    out, err = capsys.readouterr()
    assert err == ""
    assert "body: made passive: poles unchanged" in out
    assert "residues moved" in out
    assert out.rstrip().endswith("ok")


def test_a_repair_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PassivityError, match=r"body: body\.csv: making it passive would change its mobility by") as f:
        assemble(bundle(tmp_path, repair="passive", max_change=1e-6), FS)
    assert "\n" not in str(f.value)


def test_what_is_only_heard_is_not_asked_to_be_passive(tmp_path: Path) -> None:
    """A microphone among the points: its rows have nothing to do with power; forces on it are refused."""
    poles, right, left = ONE.modes
    heard = np.vstack([right, right[0] * np.exp(2j)]), np.vstack([left, 0.3j * left[1]])
    (tmp_path / "body.csv").write_text(table((poles, *heard), (*PORTS, "mic")))
    values = copy.deepcopy(VALUES)
    values["body"]["points"] |= {"mic": {}}
    with pytest.raises(PassivityError):
        assemble(Instrument.from_values(values, tmp_path), FS)
    values["body"]["points"]["mic"]["driven"] = False
    model = assemble(Instrument.from_values(values, tmp_path), FS)
    assert model.warnings == ()
    values["exciters"]["tap"]["at"] = "body.mic"
    with pytest.raises(BundleError, match=r"exciters\.tap\.at: there is no point 'body\.mic'; there are body\.low, "):
        Instrument.from_values(values, tmp_path)


@pytest.mark.slow
def test_repair_leaves_what_is_only_heard(tmp_path: Path) -> None:
    poles, right, left = KEPT
    mic = np.vstack([right, right[0] * np.exp(2j)]), np.vstack([left, left[1]])
    (tmp_path / "body.csv").write_text(table((poles, *mic), (*PORTS, "mic")))
    values = copy.deepcopy(VALUES)
    values["body"] |= {"repair": "passive", "max_change": 0.5}
    values["body"]["points"] |= {"mic": {"driven": False}}
    made = Instrument.from_values(values, tmp_path).body.basis(0.45 * FS)
    alone = bundle(tmp_path, repair="passive", max_change=0.5).body.basis(0.45 * FS)
    np.testing.assert_allclose(made.right[3], mic[0][3], rtol=1e-12)
    np.testing.assert_array_equal(made.left[:3], alone.left)


@pytest.mark.slow
def test_a_list_that_the_sampling_rate_cuts_is_judged_as_cut(tmp_path: Path) -> None:
    """The complete list passes at 48 kHz; at 8 kHz half of its modes cannot be stepped, and the rest is broken."""
    (tmp_path / "body.csv").write_text(table(ONE.modes))
    instrument = Instrument.from_values(copy.deepcopy(VALUES), tmp_path)
    assert assemble(instrument, FS).n_modes > 40
    with pytest.raises(PassivityError, match="not passive"):
        assemble(instrument, 8000)
    assemble(instrument.replace({"body.repair": "passive", "body.max_change": 0.5}), 8000)


class Perpetual(Body[Parameters]):
    """Somebody else's body, which does not test itself."""

    api = 1
    Parameters = Parameters

    def points(self) -> dict[str, BodyPoint]:
        return {name: BodyPoint((0.0, 0.0, 1.0)) for name in PORTS}

    def basis(self, freq_upper: float) -> ModalBasis:
        return ModalBasis.real([500.0, 900.0], [5.0, -0.1], {name: [1.0, 0.5] for name in PORTS})


def test_every_plugins_body_is_tested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instrument = bundle(tmp_path)
    perpetual = Perpetual.from_values({})
    monkeypatch.setattr(type(instrument.body), "basis", lambda self, freq_upper: perpetual.basis(freq_upper))
    with pytest.raises(PassivityError, match=r"instrument\.yaml: body: not passive: 1 pole\(s\) grow, fastest 143\.2"):
        assemble(instrument, FS)


@pytest.mark.parametrize(
    ("sigma", "residual", "said"),
    [
        ([1.0, 0.0, 300.0], 1e-8, None),
        ([1.0, 0.0, -300.0], 1e-8, "negative damping"),
        ([1.0, 0.0, 300.0], -1e-8, "residual compliance has the negative eigenvalue -1e-08"),
    ],
)
def test_blocks_and_residuals(sigma: list[float], residual: float, said: str | None) -> None:
    """A vibrating, a rigid-body and an overdamped mode."""
    made = ModalBasis.real([500.0, 0.0, 100.0], sigma, {"p": np.ones(3)}, residual=[[residual]])
    report = check_basis(made, ["p"], dt=1 / FS)
    assert report.passive == (said is None)
    assert said is None or said in report.summary()
    assert report.n_modes == 3
