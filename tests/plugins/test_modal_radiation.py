"""Microphones against the discrete bank their table stands for, run sample by sample in a few lines here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tonewood.errors import BundleError
from tonewood.instrument.contract.base import BodyPoint, BridgeForce, Scene
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import plugin
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.stepper import NumpyStepper

ROWS = [
    # f_Hz, Q, a, a_moment, b, b_moment
    (210.0, 12.0, 0.004 - 0.01j, 0.001j, -0.002 + 0j, 0.0005 + 0.0002j),
    (1450.0, 40.0, 0.001 + 0.002j, -0.0007 + 0j, 0.003j, 0.0),
]


def table() -> str:
    head = "f_Hz,Q," + ",".join(f"{c}{m}_{x}" for c in "ab" for m in ("", "_moment") for x in ("re", "im"))
    lines = [
        ",".join(map(str, (f, q, *(part for r in residues for part in (complex(r).real, complex(r).imag)))))
        for f, q, *residues in ROWS
    ]
    return "\n".join(["# residues of a discrete bank", head, *lines])


def make(folder: Path, **values: Any) -> Any:
    (folder / "radiation.csv").write_text(table())
    files = Files(folder, folder / "instrument.yaml")
    given = {"table": "radiation.csv", "channels": ["b", "a"], "residue_fs": 48000.0, **values}
    return plugin("modal_radiation").from_values(given, files, "outputs.mics")


def scene(**more: Any) -> Scene:
    points = {"bass": BodyPoint((0.0, 0.0, 1.0), {"u": -0.8}), "far": BodyPoint((0.0, 0.0, 1.0), {"u": 1.0})}
    forces = (BridgeForce("s.bridge", "bass", -0.9), BridgeForce("t.bridge", "far", -1.0))
    given: dict[str, Any] = {"body_points": points, "bridge_forces": forces, "string_points": {}, "end_forces": {}}
    return Scene(**{**given, "freq_upper": 20000.0, **more})


@pytest.mark.parametrize("fs", [48000.0, 96000.0])
def test_same_numbers_as_the_discrete_bank(tmp_path: Path, fs: float) -> None:
    """Two strings' forces, random; p_{n+1} = sum R' f_n + p' (state), R' = R (p' - 1) / (p48 - 1)."""
    rows = make(tmp_path, force_sign=-1).rows("mics", scene())
    # two light masses on dashpots: their connection forces are whatever they are, and are recorded
    mass = ModalBasis.real([900.0], [30.0], {"p": [1.0]}, modal_mass=0.01)
    other = ModalBasis.real([3100.0], [90.0], {"p": [1.0]}, modal_mass=0.02)
    joints = [
        Connection("s.bridge", (Term("m", "p"),), SpringDashpot(2e4, 1.0)),
        Connection("t.bridge", (Term("o", "p"),), SpringDashpot(5e4, 2.0)),
    ]
    system = System.build(
        {"m": mass, "o": other, **rows.components}, joints, rows.readouts, dt=1 / fs, drives=rows.drives
    )
    state = system.start()
    system.modes_of(state, "m")[:] = 1e-3
    system.modes_of(state, "o")[:] = -2e-3
    out, forces = NumpyStepper(system).run(state, 300)
    on_body = np.array([-0.9 * forces[:, 0], -1.0 * forces[:, 1]])
    u = np.array([-0.8, 1.0])
    heave, moment = -on_body.sum(axis=0), -(u @ on_body)  # force_sign -1: into the soundboard is positive
    for channel, name in enumerate("ba"):
        expected = np.zeros(300)
        for f, q, *residues in ROWS:
            r, rm = residues[:2] if name == "a" else residues[2:]
            pole = np.pi * f * (-1 / q + 2j)
            p, p48 = np.exp(pole / fs), np.exp(pole / 48000.0)
            z = 0j
            for n in range(300):
                expected[n] += 2 * z.real
                z = p * z + (r * heave[n] + rm * moment[n]) * (p - 1) / (p48 - 1)
        np.testing.assert_allclose(out[:, channel], expected, atol=1e-12 * np.abs(expected).max())


def test_taps_are_heard_too(tmp_path: Path) -> None:
    rows = make(tmp_path).rows("mics", scene())
    assert rows.body_inputs["bass"] == (("mics", "heave", 1.0), ("mics", "moment", -0.8))


def test_continuous_residues(tmp_path: Path) -> None:
    basis = make(tmp_path, residue_fs=None).basis(20000.0)
    f, q, r = ROWS[0][0], ROWS[0][1], ROWS[0][2]
    pole = np.pi * f * (-1 / q + 2j)
    s = 2j * np.pi * 205.0
    expected = r / (s - pole) + np.conj(r) / (s - np.conj(pole))
    pole2, r2 = np.pi * ROWS[1][0] * (-1 / ROWS[1][1] + 2j), ROWS[1][2]
    expected += r2 / (s - pole2) + np.conj(r2) / (s - np.conj(pole2))
    assert basis.frf([205.0], "a", "heave", "receptance")[0] == pytest.approx(expected, rel=1e-12)


def test_modes_above_the_limit_are_left_out(tmp_path: Path) -> None:
    assert make(tmp_path).basis(1000.0).n_modes == 2


def test_faults(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"outputs\.mics\.table: radiation\.csv: no column 'c_re'"):
        make(tmp_path, channels=["c"]).rows("mics", scene())
    nowhere = {"bass": BodyPoint((0.0, 0.0, 1.0)), "far": BodyPoint((0.0, 0.0, 1.0))}
    with pytest.raises(BundleError, match="has no place u on the bridge"):
        make(tmp_path).rows("mics", scene(body_points=nowhere))
    beyond = {"bass": BodyPoint((0.0, 0.0, 1.0), {"u": -1.01}), "far": BodyPoint((0.0, 0.0, 1.0), {"u": 0.0})}
    with pytest.raises(BundleError, match=r"'bass' lies at u = -1\.01; -1 to 1 are allowed"):
        make(tmp_path).rows("mics", scene(body_points=beyond))
    with pytest.raises(BundleError, match=r"there is no file 'other\.csv'"):
        make(tmp_path, table="other.csv").basis(1000.0)


def test_a_low_cut_is_the_high_pass_it_says(tmp_path: Path) -> None:
    """H(s) s^2 / ((s + a) (s + b)) at frequencies below, in and above the fit's range; nothing at all at 0 Hz."""
    freq = np.array([0.0, 5.0, 16.0, 80.0, 210.0, 3000.0])
    plain, cut = make(tmp_path).basis(20000.0), make(tmp_path, low_cut=16.0).basis(20000.0)
    s, a, b = 2j * np.pi * freq, 2 * np.pi * 16.0 * 0.8, 2 * np.pi * 16.0 * 1.25
    for channel in "ab":
        for point in ("heave", "moment"):
            whole = plain.frf(freq, channel, point, "receptance")
            expected = whole * s**2 / ((s + a) * (s + b))
            np.testing.assert_allclose(
                cut.frf(freq, channel, point, "receptance"), expected, rtol=1e-10, atol=1e-13 * np.abs(whole).max()
            )


def test_every_point_has_a_response_of_its_own(tmp_path: Path) -> None:
    """H = sum R / (s - p) + conj. of each point and channel, against that sum; a pole that is not heard is left out."""
    poles = [(120.0, 9.0), (900.0, 30.0), (2500.0, 5.0)]
    residues = {
        ("a", "x"): [0.1 + 0.2j, -0.3, 0.0],
        ("a", "y"): [0.5j, 0.2, 0.0],
        ("b", "x"): [0.1, 0.4, 0.7],
        ("b", "y"): [1, 2j, 3],
    }
    head = ["f_Hz", "Q", *(f"{c}_at_{p}_{part}" for c, p in residues for part in ("re", "im"))]
    rows = [
        [f, q, *(part for values in residues.values() for part in (complex(values[k]).real, complex(values[k]).imag))]
        for k, (f, q) in enumerate(poles)
    ]
    (tmp_path / "table.csv").write_text("\n".join(",".join(map(str, row)) for row in [head, *rows]))
    values = {"table": "table.csv", "channels": ["a", "b"], "driven_by": "points"}
    made = plugin("modal_radiation").from_values(values, Files(tmp_path, tmp_path / "instrument.yaml"), "outputs.mics")
    points = {"x": BodyPoint((0.0, 0.0, 1.0)), "y": BodyPoint((0.0, 1.0, 0.0))}
    forces = (BridgeForce("s.bridge", "x", -0.9), BridgeForce("t.bridge", "y", -1.0))
    found = made.rows("mics", scene(body_points=points, bridge_forces=forces))
    assert [(d.point, d.factor) for d in found.drives] == [("at_x", -0.9), ("at_y", -1.0)]
    basis = found.components["mics"]
    assert len(basis.poles) == 5
    s = 2j * np.pi * 700.0
    for (channel, point), values in residues.items():
        expected = 0.0
        for (f, q), r in zip(poles, values, strict=True):
            p = np.pi * f * (-1 / q + 2j)
            expected += r / (s - p) + np.conj(r) / (s - np.conj(p))
        left, right = basis.left[basis.index(f"at_{point}")], basis.right[basis.index(channel)]
        both = left * right
        assert np.sum(both / (s - basis.poles) + both.conj() / (s - basis.poles.conj())) == pytest.approx(
            expected, rel=1e-9
        )
