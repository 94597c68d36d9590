"""Bodies from tables: mobilities against the formulas the tables stand for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.errors import PassivityError, TonewoodError
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import plugin

FREQ = np.array([60.0, 101.0, 140.0, 300.0, 777.0])
S = 2j * np.pi * FREQ


def make(folder: Path, table: str, **values: Any) -> Any:
    (folder / "body.csv").write_text(table)
    files = Files(folder, folder / "instrument.yaml")
    return plugin("modal_table").from_values({"table": "body.csv", **values}, files, "body")


def term(f: float, q: float) -> np.ndarray:
    w = 2 * np.pi * f
    return np.asarray(S / (S**2 + w / q * S + w**2))


def test_modal_mass_and_shapes(tmp_path: Path) -> None:
    body = make(
        tmp_path, "# a note\nf_Hz,Q,modal_mass,a,b\n100,20,0.2,1,-0.5\n250,35,0.1,0.7,1\n",
        shapes="points", points={"left": {"column": "a"}, "right": {"column": "b"}},
    ).basis(1000.0)  # fmt: skip
    expected = term(100, 20) * (1 * -0.5) / 0.2 + term(250, 35) * (0.7 * 1) / 0.1
    np.testing.assert_allclose(body.frf(FREQ, "left", "right"), expected, rtol=1e-10)


def test_all_columns_are_points(tmp_path: Path) -> None:
    """A column that a named point takes is that point, not another one of the column's name."""
    table = "f_Hz,Q,modal_mass,a,b\n100,20,0.2,1,-0.5\n250,35,0.1,0.7,1\n"
    body = make(tmp_path, table, shapes="points", columns="all")
    assert list(body.points()) == ["a", "b"]
    expected = term(100, 20) * (1 * -0.5) / 0.2 + term(250, 35) * (0.7 * 1) / 0.1
    np.testing.assert_allclose(body.basis(1000.0).frf(FREQ, "a", "b"), expected, rtol=1e-10)
    named = make(tmp_path, table, shapes="points", columns="all", points={"left": {"column": "a", "direction": "y"}})
    assert set(named.points()) == {"left", "b"}
    assert named.points()["left"].direction == (0.0, 1.0, 0.0)
    np.testing.assert_allclose(named.basis(1000.0).frf(FREQ, "left", "b"), expected, rtol=1e-10)


def test_a_table_without_a_point_is_one_line(tmp_path: Path) -> None:
    body = make(tmp_path, "f_Hz,Q\n100,20\n", shapes="points", columns="all")
    with pytest.raises(TonewoodError, match="no column is a point; there are f_Hz, Q"):
        body.basis(1000.0)


def test_points_or_all_columns_are_wanted(tmp_path: Path) -> None:
    table = "f_Hz,Q,p\n100,20,1\n"
    with pytest.raises(TonewoodError, match="at least one is wanted, or columns: all"):
        make(tmp_path, table, shapes="points")
    with pytest.raises(TonewoodError, match="columns: all is for shapes: points"):
        make(tmp_path, table, shapes="residues", reference="p", columns="all")


def test_residues_per_point(tmp_path: Path) -> None:
    body = make(
        tmp_path, "f_Hz,zeta,ref,far\n100,0.01,4,-3\n250,0.02,1,2\n",
        shapes="residues", reference="ref", points={"ref": {}, "far": {}},
    ).basis(1000.0)  # fmt: skip
    np.testing.assert_allclose(body.frf(FREQ, "far", "ref"), term(100, 50) * -3 + term(250, 25) * 2, rtol=1e-10)
    np.testing.assert_allclose(body.frf(FREQ, "far", "far"), term(100, 50) * 9 / 4 + term(250, 25) * 4, rtol=1e-10)


def test_what_stands_above_a_rocking_line_moves_sideways(tmp_path: Path) -> None:
    """A rigid bar on the line: its ends u = +-1 move by dz, its top, h above, by -h (dz_1 - dz_-1) / (2 b)."""
    table = "f_Hz,Q,heave,cross,rock\n100,20,4.0,-2.0,1.0\n250,35,1.0,0.3,0.5\n"
    points = {"low": {"u": -1.0}, "high": {"u": 1.0}, "side": {"lever": 0.4, "direction": "y"}}
    body = make(tmp_path, table, shapes="heave_rock", points=points)
    made = body.basis(1000.0)
    for driven in points:
        dz = {p: made.frf(FREQ, p, driven) for p in ("low", "high")}
        np.testing.assert_allclose(
            made.frf(FREQ, "side", driven), -0.4 * (dz["high"] - dz["low"]) / 2, rtol=1e-9, atol=1e-12
        )
    assert body.points()["side"].direction == (0.0, 1.0, 0.0)
    with pytest.raises(TonewoodError, match="along y with a lever"):
        make(tmp_path, table, shapes="heave_rock", points={"p": {"lever": 0.4}}).basis(1000.0)
    with pytest.raises(TonewoodError, match="or else a lever"):
        make(tmp_path, table, shapes="heave_rock", points={"p": {}}).basis(1000.0)


def test_heave_and_rock(tmp_path: Path) -> None:
    """Any pair of places on the line: rank one (first row), rank two (second), rounding below rank (third)."""
    rows = [(100, 20, 4.0, -2.0, 1.0), (250, 35, 1.0, 0.3, 0.5), (400, 30, 2.0, 1e-8, -1e-9)]
    table = "f_Hz,Q,heave,cross,rock\n" + "\n".join(",".join(map(str, r)) for r in rows)
    body = make(
        tmp_path, table, shapes="heave_rock", points={"p": {"u": -0.6}, "r": {"u": 1.0}},
        truncation={"residual_compliance": [3e-8, 1e-8, 2e-8]},
    ).basis(1000.0)  # fmt: skip
    assert body.n_modes == 4
    for a, ua in (("p", -0.6), ("r", 1.0)):
        for b, ub in (("p", -0.6), ("r", 1.0)):
            expected = sum(term(f, q) * (h + (ua + ub) * c + ua * ub * k) for f, q, h, c, k in rows)
            expected = expected + S * (3e-8 + (ua + ub) * 1e-8 + ua * ub * 2e-8)
            np.testing.assert_allclose(body.frf(FREQ, a, b), expected, rtol=1e-6)


def test_modes_above_the_limit_become_compliance(tmp_path: Path) -> None:
    table = "f_Hz,Q,p\n100,20,1\n5000,30,2\n"
    whole = make(tmp_path, table, shapes="points", points={"p": {}}).basis(10000.0)
    part = make(tmp_path, table, shapes="points", points={"p": {}}).basis(1000.0)
    assert part.n_modes == 1
    assert part.residual[0, 0] == pytest.approx(4 / (2 * np.pi * 5000) ** 2)
    assert part.static_compliance()[0, 0] == pytest.approx(whole.static_compliance()[0, 0])


def two_mass_modes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    M, C = np.diag([0.2, 0.1]), np.array([[4.0, -1.0], [-1.0, 1.5]])
    K = np.array([[9e4, -2e4], [-2e4, 3e5]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-sla.solve(M, K), -sla.solve(M, C)]])
    lam, psi = sla.eig(A)
    lam, psi = lam[lam.imag > 0], psi[:2, lam.imag > 0]
    norm = np.array([v @ (2 * s * M + C) @ v for s, v in zip(lam, psi.T, strict=True)])
    receptance = np.array([sla.inv(s**2 * M + s * C + K) for s in S])
    return lam, np.stack([psi, psi / norm]), receptance


def complex_table(lam: np.ndarray, shapes: np.ndarray) -> str:
    head = "f_Hz,zeta," + ",".join(f"{p}_{s}_{x}" for p in ("a", "b") for s in ("right", "left") for x in ("re", "im"))
    rows = []
    for k, s in enumerate(lam):
        row = [abs(s) / (2 * np.pi), -s.real / abs(s)]
        for p in range(2):
            for side in range(2):
                row += [shapes[side, p, k].real, shapes[side, p, k].imag]
        rows.append(",".join(f"{x:.16g}" for x in row))
    return head + "\n" + "\n".join(rows)


def test_complex_modes_give_back_the_matrices(tmp_path: Path) -> None:
    lam, shapes, receptance = two_mass_modes()
    body = make(tmp_path, complex_table(lam, shapes), shapes="complex", points={"a": {}, "b": {}}).basis(1000.0)
    for i, a in enumerate("ab"):
        for j, b in enumerate("ab"):
            np.testing.assert_allclose(body.frf(FREQ, a, b, "receptance"), receptance[:, i, j], rtol=1e-9)


def test_a_body_that_would_create_energy_is_refused_or_mended(tmp_path: Path) -> None:
    lam, shapes, _ = two_mass_modes()
    turned = shapes * np.exp(0.12j * np.arange(1, 3))  # phases that belong to no body
    table, points = complex_table(lam, turned), {"a": {}, "b": {}}
    with pytest.raises(PassivityError, match=r"body: body\.csv: not passive.*`repair: passive`"):
        make(tmp_path, table, shapes="complex", points=points).basis(1000.0)
    mended = make(tmp_path, table, shapes="complex", points=points, repair="passive", max_change=0.9).basis(1000.0)
    for f in np.geomspace(5, 5000, 200):
        Y = np.array([[mended.frf([f], a, b)[0] for b in "ab"] for a in "ab"])
        assert sla.eigvalsh(0.5 * (Y + Y.conj().T))[0] > -1e-9 * np.abs(Y).max()
    with pytest.raises(PassivityError, match=r"body: body\.csv"):
        make(tmp_path, table, shapes="complex", points=points, repair="passive", max_change=1e-4).basis(1000.0)


def test_damping_case_keeps_poles_and_makes_shapes_real(tmp_path: Path) -> None:
    lam, shapes, _ = two_mass_modes()
    table, points = complex_table(lam, shapes), {"a": {}, "b": {}}
    complex_case = make(tmp_path, table, shapes="complex", points=points).basis(1000.0)
    proportional = make(tmp_path, table, shapes="complex", points=points, damping_case="proportional").basis(1000.0)
    np.testing.assert_allclose(proportional.poles, complex_case.poles)
    ratio = proportional.right / proportional.right[0]
    assert np.abs(ratio.imag).max() < 1e-9 * np.abs(ratio).max()


HEAVE: dict[str, Any] = {"shapes": "heave_rock", "points": {"p": {"u": 0.0}}}
POINTS: dict[str, Any] = {"shapes": "points", "points": {"p": {}}}


@pytest.mark.parametrize(
    ("table", "values", "reason"),
    [
        ("f_Hz,Q,x\n100,20,1", POINTS, r"no column 'p'; there are f_Hz, Q, x"),
        ("f_Hz,p\n100,1", POINTS, "one column Q or zeta"),
        ("f_Hz,Q,zeta,p\n100,20,0.1,1", POINTS, "one column Q or zeta"),
        ("f_Hz,Q,p\n-100,20,1", POINTS, "must be above 0"),
        ("f_Hz,Q,modal_mass,p\n100,20,0,1", POINTS, "modal masses must be above 0"),
        ("f_Hz,Q,p\n100,20,1\n1_82,20,1", POINTS, r"body\.csv: line 3, column f_Hz: '1_82' is not a finite number"),
        ("f_Hz,Q,p\n100,٣,1", POINTS, r"body\.csv: line 2, column Q: '٣' is not a finite number"),
        ("f_Hz,Q,p\n100,20,nan", POINTS, r"body\.csv: line 2, column p: 'nan' is not a finite number"),
        ("f_Hz,Q,p\n100,20", POINTS, r"body\.csv: line 2: 2 numbers under 3 columns"),
        ("f_Hz,Q,p\n", POINTS, r"body\.csv: holds no rows"),
        ("f_Hz,Q,heave,cross,rock\n100,20,1,2,1", HEAVE, "not positive semidefinite"),
        ("f_Hz,Q,heave,cross,rock\n100,20,1,0,1", {**HEAVE, "points": {"p": {}}}, r"points\.p: .*needs the place u"),
        (
            "f_Hz,Q,heave,cross,rock\n100,20,1,0,1",
            {**HEAVE, "points": {"p": {"u": 0.0, "direction": "y"}}},
            r"points\.p\.direction: .*along z at u",
        ),
        ("f_Hz,Q,p\n100,20,1", {**POINTS, "truncation": {"residual_compliance": [[1.0, 2.0], [2.0, 1.0]]}}, "1 x 1"),
        ("f_Hz,Q,p\n100,20,1", {**POINTS, "truncation": {"residual_compliance": -1e-8}}, "create energy"),
        ("f_Hz,Q,p\n100,20,1", {**POINTS, "shapes": "residues"}, r"reference: names the driven point"),
    ],
)
def test_faults_are_one_line(tmp_path: Path, table: str, values: dict[str, Any], reason: str) -> None:
    with pytest.raises(TonewoodError, match=reason) as fault:
        make(tmp_path, table, **values).basis(1000.0)
    assert "\n" not in str(fault.value)
    assert str(tmp_path) in str(fault.value)
