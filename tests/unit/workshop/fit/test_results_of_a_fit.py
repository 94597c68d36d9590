"""Bodies, tables, warnings, pictures and folders of a fit."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from fit_parts import FREQ, REAL, resonances
from fit_scenes import TAU, Truth, random_body

from tonewood.errors import TonewoodError
from tonewood.workshop.fit import arrays, figure, folder, noise, radiation
from tonewood.workshop.fit import fit as whole
from tonewood.workshop.fit.body import _shapes, passive_body
from tonewood.workshop.fit.fit import Fit, fit_responses
from tonewood.workshop.fit.identify import identify
from tonewood.workshop.fit.projection import FitData, LinearFit, Poles, Projection, Shape
from tonewood.workshop.fit.radiation import FittedRadiation
from tonewood.workshop.fit.responses import Responses
from tonewood.workshop.fit.stability import ORDERS, stability

# -- bodies ------------------------------------------------------------------------------------------------------------


def test_poles_of_a_body_are_stable_at_every_order(truth) -> None:
    chart = stability(FREQ, truth.mobility(FREQ))
    assert set(chart.order) <= set(ORDERS)
    for f, q in zip(truth.freq, truth.quality, strict=True):
        near = (np.abs(chart.freq / f - 1) < 1e-3) & (np.abs(chart.quality / q - 1) < 0.05)
        assert set(chart.order[near]) >= set(ORDERS[2:])
        assert chart.stable[near & (chart.order > 12)].all()
    assert not chart.stable[chart.order == 4].any()
    assert chart.freq.min() >= 60
    assert chart.freq.max() <= 800


def test_a_bank_of_microphones_is_written_as_its_residues() -> None:
    pole = np.array([-10.0 + 600j])
    bank = FittedRadiation(
        ("l", "r"), pole, 20.0, np.array([[1 + 2j], [3.0]]), np.array([[0.5j], [0.0]]), np.zeros((0, 0))
    )
    _, names, row = bank.table().splitlines()
    assert names == "f_Hz,Q,l_re,l_im,l_moment_re,l_moment_im,r_re,r_im,r_moment_re,r_moment_im"
    assert [float(x) for x in row.split(",")] == pytest.approx([600 / TAU, 30.0, 1, 2, 0, 0.5, 3, 0, 0, 0])
    s = 4.0 + 1j * TAU * 90.0
    cut = s * s / ((s + 0.8 * TAU * 20) * (s + 1.25 * TAU * 20))
    wanted = [cut * (r / (s - pole[0]) + np.conj(r) / (s - np.conj(pole[0]))) for r in (1 + 2j - 0.25j, 3.0)]
    assert bank.pressure(np.array([90.0]), -0.5, 4.0)[:, 0] == pytest.approx(wanted)


def exact(truth, shape=REAL, pairs=(("a", "a"), ("b", "a")), beside=0.0, sigma=1e-6):
    """Modes of a problem of known residues."""
    y = truth.mobility(FREQ) + beside
    problem = Projection(FitData(FREQ, y, np.full(y.shape, sigma)), shape)
    poles = Poles.at(truth.freq, truth.quality)
    return SimpleNamespace(problem=problem, poles=poles, solution=problem.solve(poles)), pairs


def test_a_body_has_the_shapes_of_its_residues(truth) -> None:
    body = passive_body(*exact(truth))
    assert body.points == ("a", "b")
    assert body.freq == pytest.approx(truth.freq)
    assert body.quality == pytest.approx(truth.quality)
    assert body.shapes == pytest.approx((truth.residues / np.sqrt(truth.residues[0])).T, rel=1e-5)
    assert body.measured.all()
    assert not body.compliance.any()
    assert [line.split(":")[0] for line in body.dropped] == [
        "mass line of modes below the band",
        "compliance of modes above the band",
    ]
    assert body.mobility(FREQ, (("b", "a"), ("b", "b")))[0] == pytest.approx(truth.mobility(FREQ)[1], rel=1e-4)
    bb = (truth.residues[1] ** 2 / truth.residues[0]) @ resonances(FREQ, truth.freq, truth.quality, 2.0)
    assert body.mobility(FREQ, (("b", "b"),), 2.0)[0] == pytest.approx(bb, rel=1e-4)
    deviations = exact(truth)[0].problem.deviations(Poles.at(truth.freq, truth.quality))
    assert body.cents == pytest.approx(1200 * deviations[0] / np.log(2))
    assert body.quality_error == pytest.approx(deviations[1])
    assert body.shape_error == pytest.approx(0.5 * deviations[2][0, :3] / truth.residues[0], rel=1e-5)


def test_modes_beyond_the_band_become_a_mass_and_a_compliance(truth) -> None:
    """Residues E of 0.2 and 0.1, C of 0.4 and 0.2 re the middle of the band."""
    scale, s = TAU * np.sqrt(60.0 * 800.0), 1j * TAU * FREQ
    lower, upper = np.array([[4e-3], [2e-3]]), np.array([[8e-3], [4e-3]])
    shape = Shape((0,), 2, False)
    body = passive_body(*exact(truth, shape, beside=lower * scale / s + upper * s / scale, sigma=1e-9))
    assert body.freq == pytest.approx([60.0 / 8, *truth.freq])
    assert body.quality[0] == 5.0
    assert body.shapes[0] == pytest.approx(np.sqrt(scale) * np.array([4e-3, 2e-3]) / np.sqrt(4e-3), rel=1e-3)
    assert body.compliance == pytest.approx(np.array([[8e-3, 4e-3], [4e-3, 2e-3]]) / scale, rel=1e-3)
    assert body.measured.tolist() == [False, True, True, True]
    assert np.isnan(body.cents[0])
    assert body.dropped == ()


def test_several_references_and_modes_that_create_energy() -> None:
    one = Truth(
        np.array([200.0, 500.0]), np.array([40.0, 1.9]), np.array([[4.0, 1.0], [2.0, -1.0], [2.2, -1.0], [1.0, 1.0]])
    )
    pairs = (("a", "a"), ("b", "a"), ("a", "b"), ("b", "b"))
    body = passive_body(*exact(one, Shape((0, 3), 2, False, False, False), pairs, sigma=0.1))
    values, vectors = np.linalg.eigh([[4.0, 2.1], [2.1, 1.0]])
    assert np.abs(body.shapes[0]) == pytest.approx(np.abs(vectors[:, -1]) * np.sqrt(values[-1]), rel=1e-3)
    assert np.abs(body.shapes[1]) == pytest.approx([1.0, 1.0], rel=1e-3)
    assert body.shapes[1].prod() == pytest.approx(-1.0, rel=1e-3)
    assert body.measured.tolist() == [True, False]  # Q below 2
    # of every residue known alike, the driving one is measured once, that of two points twice
    deviations = exact(one, Shape((0, 3), 2, False, False, False), pairs, sigma=0.1)[0].problem.deviations(
        Poles.at(one.freq, one.quality)
    )[2]
    assert body.shape_error[0] == pytest.approx(0.5 * deviations[0, 0] / values[-1], rel=1e-3)
    negative = Truth(np.array([200.0, 500.0]), np.array([40.0, 30.0]), np.array([[4.0, -1.0], [2.0, 1.0]]))
    left = passive_body(*exact(negative))
    assert left.freq == pytest.approx([200.0])
    assert left.dropped[0] == "mode at 500.0 Hz: negative residue at the driving point"


@pytest.mark.parametrize(
    ("weak", "certain", "count"),
    [(0.44, True, 1), (0.46, True, 2), (0.46, False, 2), (0.44, False, 1), (-0.1, True, 1)],
)
def test_further_shapes_stand_out_by_four_and_a_half_deviations(weak, certain, count) -> None:
    """Residues diag(4, weak) known within 0.1; of one reference alone a shape that is not certain needs three."""
    pairs = (("a", "a"), ("b", "a"), ("b", "b"))
    shapes, error = _shapes(np.array([4.0, 0.0, weak]), np.full(3, 0.1), pairs, ("a", "b"), certain=certain)
    assert error == pytest.approx(0.1 / 4)
    assert [np.abs(x).tolist() for x in shapes] == [[2.0, 0.0], [0.0, np.sqrt(abs(weak))]][:count]
    for value, kept in ((0.29, certain), (0.31, True), (-0.1, False)):
        shapes, error = _shapes(np.array([value, 0.3]), np.full(2, 0.1), pairs[:2], ("a", "b"), certain=certain)
        assert len(shapes) == kept
        if kept:
            assert shapes[0] == pytest.approx(np.array([value, 0.3]) / np.sqrt(value))
        assert error == pytest.approx(0.1 / value if kept else np.inf)


# -- fits --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted() -> Fit:
    truth = Truth(np.array([150.0, 320.0]), np.array([30.0, 50.0]), np.array([[1.0, 2.0], [-0.5, 1.0]]))
    freq = np.arange(80.0, 481.0)
    y, _ = truth.noisy(freq, 0.003, 1)
    r = Responses(freq, y, (("a", "a"), ("b", "a")), files={"x.csv": "0"}, kept=(4, 5), remarks=("a remark",))
    return fit_responses(r, damping="viscous")


def test_a_fit_without_a_mode_or_with_one_to_drop_that_is_none_is_refused(fitted) -> None:
    r = fitted.responses
    rng = np.random.default_rng(2)
    noise_alone = rng.standard_normal(r.mobility.shape) + 1j * rng.standard_normal(r.mobility.shape)
    with pytest.raises(TonewoodError, match="responses: no mode stands out of the noise: wrong files, band or"):
        fit_responses(replace(r, mobility=noise_alone), damping="viscous")
    turned = fit_responses(replace(r, mobility=-r.mobility), damping="viscous")
    assert (turned.body, len(turned.modes.poles)) == (None, 2)
    assert "mobility of 'a' has a negative real part" in turned.no_body
    problem, poles, solution = turned.modes.bent
    by_freq, by_zeta, _ = problem.deviations(poles)
    rows = turned.rows
    assert [row["sd_cents"] for row in rows] == pytest.approx(1200 * np.log2(np.e) * by_freq)
    assert [row["sd_Q"] for row in rows] == pytest.approx(by_zeta)
    whole_row = problem.model(poles, solution.residues)
    for i, row in enumerate(rows):
        part = solution.residues[:, [i, i + 2]] @ problem.columns(poles)[0][[i, i + 2]]
        change = np.abs(20 * np.log10(np.abs(1 - part / whole_row))).max()
        assert row["without_db"] == pytest.approx(change)
        shape = solution.residues[:, i] - 1j * solution.residues[:, i + 2]
        assert np.array(row["shape"]) @ [1, 1j] == pytest.approx(shape / shape[np.argmax(np.abs(shape))])
        assert (row["mass_kg"], row["sd_shape"], row["interval_90"].get("mass_kg")) == (None, None, None)
    with pytest.raises(TonewoodError, match="--drop: there is no mode at 250 Hz; the nearest is at 320"):
        fit_responses(r, damping="viscous", drop=(250.0,))


def test_a_coherence_is_the_least_noise_of_a_fit(fitted) -> None:
    coherence = np.full(fitted.responses.mobility.shape, 0.9)
    fit = fit_responses(replace(fitted.responses, coherence=coherence, n_hits=4), damping="viscous")
    least = noise.of_coherence(fit.responses.mobility, coherence, 4)
    assert np.all(fit.modes.problem.data.sigma >= 0.999 * least)
    assert np.median(fit.modes.problem.data.sigma / least) < 1.2
    assert np.median(fitted.modes.problem.data.sigma / least) < 0.2


def test_rows_of_a_fit_have_intervals_and_changes(fitted) -> None:
    measured = [row for row in fitted.rows if row["measured"]]
    assert [row["freq_Hz"] for row in measured] == pytest.approx([150.0, 320.0], rel=1e-3)
    assert [row["mass_kg"] for row in measured] == pytest.approx([1.0, 0.5], rel=0.02)
    k = 1.6449
    for row in measured:
        spread = np.exp(k * row["sd_cents"] * np.log(2) / 1200)
        assert row["interval_90"]["freq_Hz"] == pytest.approx([row["freq_Hz"] / spread, row["freq_Hz"] * spread])
        assert row["interval_90"]["Q"] == pytest.approx([row["Q"] * np.exp(x * k * row["sd_Q"]) for x in (-1, 1)])
        assert row["interval_90"]["mass_kg"] == pytest.approx(
            [row["mass_kg"] * np.exp(2 * x * k * row["sd_shape"]) for x in (-1, 1)]
        )
        assert row["mpc"] == pytest.approx(1.0, abs=1e-3)
    body, r = fitted.body, fitted.responses
    assert fitted.mobility == pytest.approx(body.mobility(r.freq, r.pairs))
    assert fitted.error_db == pytest.approx(np.abs(20 * np.log10(np.abs(fitted.mobility / r.mobility))))
    for i in range(body.freq.size):
        part = body.shapes[i, 0] ** 2 * resonances(r.freq, body.freq[i : i + 1], body.quality[i : i + 1])[0]
        change = 20 * np.log10(np.abs(1 - part / fitted.mobility[0]))
        assert fitted.without_db[i] == pytest.approx(np.abs(change).max())
    assert repr(fitted) == f"<Fit of {body.freq.size} modes, {fitted.error_db.max():.2f} dB at most>"


def test_facts_and_table_of_a_fit(fitted) -> None:
    facts = fitted.facts()
    assert (facts["band_Hz"], facts["step_Hz"], facts["window_tau_s"]) == ([80.0, 480.0], 1.0, None)
    assert facts["hits"] == {"kept": 4, "given": 5}
    assert (facts["pairs"], facts["damping"], facts["files"]) == ([["a", "a"], ["b", "a"]], "viscous", {"x.csv": "0"})
    error = fitted.error_db
    assert facts["error_db"] == pytest.approx(
        {"rms": np.sqrt(np.mean(error**2)), "95%": np.quantile(error, 0.95), "most": error.max()}
    )
    assert facts["noise"] == pytest.approx(np.sqrt(np.mean(fitted.modes.problem.data.sigma**2, axis=1)))
    assert facts["compliance_m_per_N"] == fitted.body.compliance.tolist()
    assert "a remark" in facts["warnings"]
    assert any(line.startswith("driven at a alone") for line in facts["warnings"])
    first, _, names, *rows = fitted.table().splitlines()
    assert first.startswith("# Fitted to x.csv from 80 to 480 Hz; mass-normalised shapes")
    assert names == "f_Hz,Q,a,b,sd_cents,sd_Q_percent,measured"
    cells = [[float(x) for x in row.split(",")] for row in rows]
    assert [row[:2] for row in cells] == [
        list(pair) for pair in zip(fitted.body.freq, fitted.body.quality, strict=True)
    ]
    assert [row[2:4] for row in cells] == fitted.body.shapes.tolist()
    assert [row[6] for row in cells] == [float(x) for x in fitted.body.measured]
    for row, of in zip(cells, fitted.rows, strict=True):
        wanted = (of["sd_cents"], 100 * of["sd_Q"]) if of["measured"] else (0.0, 0.0)
        assert row[4:6] == pytest.approx(wanted, rel=5e-3)


def test_warnings_of_a_fit(fitted) -> None:
    def said(rows=(), modes=None, **more):
        fit = Fit(fitted.responses, modes or fitted.modes, fitted.body, **more)
        fit.__dict__["rows"] = [{"measured": True, "mass_kg": 1.0, "freq_Hz": 300.0, "Q": 10.0} | row for row in rows]
        return "\n".join(fit.warnings)

    usual = said([{}])
    assert usual == "a remark\n" + fitted.warnings[-1]
    assert "mode at 300.0 Hz: its bandwidth of 2.9 Hz (Q 103) holds fewer than 3 bins of 1 Hz" in said([{"Q": 103.0}])
    assert said([{"Q": 100.0}]) == usual
    assert "3 modes are narrower than 3 bins of 1 Hz (300, 300, 300 Hz)" in said([{"Q": 103.0}] * 3)
    assert said([{"Q": 103.0}] * 2).count("mode at 300.0 Hz") == 2
    assert "the band ends in the peak of the mode at 470.0 Hz" in said([{"freq_Hz": 470.0, "Q": 46.0}])
    assert said([{"freq_Hz": 470.0, "Q": 48.0}]) == usual
    assert "the band ends in the peak of the mode at 81.0 Hz" in said([{"freq_Hz": 81.0, "Q": 20.0}])
    assert "half of the modes weigh less than 0.001 kg" in said([{"mass_kg": 1e-3}])
    assert said([{"mass_kg": 1.1e-3}, {"mass_kg": 1.2e-3}, {"mass_kg": 1e-5}]) == usual
    assert "half of the modes weigh more than 1e+03 kg" in said([{"mass_kg": 1e3}])
    assert "no passive body: because" in said([{}], no_body="because")
    assert "responses from 'p', 'q' were left out" in said([{}], not_driven=("p", "q"))
    seven = tuple(float(i) for i in range(100, 107))
    assert "left out, 7: 100, 101, 102, 103, 104, 105 ... Hz" in said([{}], outliers=seven)
    assert "left out, 6: 100, 101, 102, 103, 104, 105 Hz" in said([{}], outliers=seven[:6])
    assert "3 bins without a finite number" in said([{}], empty=3)
    assert "of the mains perhaps, were left out: 50.0, 100.0 Hz" in said(
        [{}], replace(fitted.modes, mains=(100.0, 50.0))
    )
    idle = said([{}], replace(fitted.modes, idle=(*seven[::-1],)))
    assert "7 weak or doubtful modes" in idle
    assert "(100, 101, 102, 103, 104, 105 ... Hz); --keep 100 would keep one" in idle
    problem, poles, solution = fitted.modes.bent
    for misfit, told in ((1.49, False), (1.51, True)):
        loud = LinearFit(misfit * problem.size, solution.residues, solution.chi2)
        lines = said([{}], replace(fitted.modes, bent=(problem, poles, loud)))
        assert (f"the misfit is {misfit:.2f} times the noise" in lines) is told


def test_low_bands_and_coherences_are_told(fitted) -> None:
    r = fitted.responses

    def said(**more):
        fit = Fit(replace(r, **more), fitted.modes, fitted.body)
        fit.__dict__["rows"] = []
        return "\n".join(fit.warnings)

    assert "the responses end at 19.9 Hz: kHz read as Hz" in said(freq=r.freq * 19.9 / 480)
    assert "kHz" not in said(freq=r.freq * 20.1 / 480)
    coherence = np.ones((2, 401))
    for k in range(5):
        coherence[0, 10 + 80 * k : 50 + 80 * k] = 0.1
    low = said(coherence=coherence, n_hits=4)
    assert "the coherence at a is low: 90 to 129 Hz, 170 to 209 Hz, 250 to 289 Hz and 2 more; move --band" in low
    assert "the coherences were not used" not in low
    assert "the coherences were not used" in said(coherence=coherence)
    assert "driven at" not in said(pairs=(("a", "a"), ("b", "b")))


@pytest.mark.parametrize(("shape", "mass"), [([0.5, 9.0], 4.0), ([0.0, 1.0], None)])
def test_masses_are_felt_at_the_first_point(shape, mass) -> None:
    assert whole._mass(np.array(shape)) == mass
    assert whole._or_none(np.inf) is None
    assert whole._or_none(2.0) == 2.0
    assert whole._change(np.array([2.0, 4.0 + 0j]), np.array([1.0, 3.0 + 0j])) == pytest.approx(20 * np.log10(4))


def test_modes_of_a_fit_without_a_driving_point(truth) -> None:
    """Shapes are residues re the largest; no mass; two points have a collinearity of 1."""
    two = random_body(2, seed=5, high=300.0)
    freq = np.arange(60.0, 361.0)
    y, _ = two.noisy(freq, 0.003, 2)
    fit = fit_responses(Responses(freq, y, (("b", "a"), ("c", "a"))), damping="viscous")
    assert fit.body is None
    assert fit.no_body.startswith("no driving point")
    inside = [row for row in fit.rows if row["measured"]]
    for row in inside:
        i = int(np.argmin(np.abs(two.freq - row["freq_Hz"])))
        assert (row["freq_Hz"], row["Q"]) == (
            pytest.approx(two.freq[i], rel=2e-3),
            pytest.approx(two.quality[i], rel=0.1),
        )
        wanted = two.residues[:, i] / two.residues[np.argmax(np.abs(two.residues[:, i])), i]
        assert [complex(*x) for x in row["shape"]] == pytest.approx(wanted, abs=0.05)
        assert (row["mass_kg"], row["sd_shape"], row["interval_90"]["mass_kg"]) == (None, None, None)
    names = fit.table().splitlines()[2]
    assert names == "f_Hz,Q,b:a_re,b:a_im,c:a_re,c:a_im,sd_cents,sd_Q_percent,measured"


# -- pictures ----------------------------------------------------------------------------------------------------------


def test_the_picture_of_a_fit_has_its_curves(fitted, monkeypatch, tmp_path) -> None:
    drawn = []
    monkeypatch.setattr(figure, "save", lambda made, path: drawn.append(made))
    figure.draw_fit(fitted, tmp_path / "a.png")
    top, off, spread, quality, chart = drawn[0].axes
    r = fitted.responses
    lines = top.lines[1:]
    for i in range(2):
        for line, values in ((lines[2 * i], r.mobility[i]), (lines[2 * i + 1], fitted.mobility[i])):
            assert line.get_ydata() == pytest.approx(20 * np.log10(np.abs(values)) - 40.0 * i)
        assert off.lines[i].get_ydata() == pytest.approx(20 * np.log10(np.abs(fitted.mobility[i] / r.mobility[i])))
    sure = [row for row in fitted.rows if row["measured"]]
    assert spread.lines[0].get_ydata() == pytest.approx([row["sd_cents"] for row in sure])
    assert quality.lines[0].get_ydata() == pytest.approx([100 * row["sd_Q"] for row in sure])
    assert spread.lines[0].get_xdata() == pytest.approx([row["freq_Hz"] for row in sure])
    stable = stability(r.freq, r.mobility)
    assert chart.lines[1].get_xdata() == pytest.approx(stable.freq[stable.stable])
    assert chart.lines[0].get_ydata().tolist() == stable.order[~stable.stable].tolist()
    most = max(1.0, np.quantile(fitted.error_db, 0.99))
    assert off.get_ylim() == pytest.approx((-most, most))


# -- folders -----------------------------------------------------------------------------------------------------------


def test_a_folder_of_a_fit_has_its_figures(fitted, tmp_path) -> None:
    """Keys of the bundle and facts against the fit; files of another fit are removed."""
    bank = FittedRadiation(
        ("l", "r"), np.array([-1 + 9j, -2 + 20j]), 12.0, np.ones((2, 2)), np.ones((2, 2)), np.array([[3.0, -4.0]])
    )
    places = {"a": folder.MeasuredPoint(), "b": folder.MeasuredPoint((0.0, 1.0, 0.0), 0.25)}
    out = folder.FitFolder(fitted, bank, places, folder.Origin(title='a "b"', licence="CC0"), {"x": 1})
    facts = out.facts()
    assert facts["radiation"] == {"channels": ["l", "r"], "modes": 2, "error_db_rms": pytest.approx(12.5**0.5)}
    assert (facts["title"], facts["settings"]) == ('a "b"', {"x": 1})
    path = tmp_path / "new"
    files = out.write(path, lambda fit, file: file.write_bytes(b"picture"))
    assert [file.name for file in files] == ["body.csv", "radiation.csv", "body.yaml", "fit.json", "fit.png"]
    assert (path / "fit.png").read_bytes() == b"picture"
    assert json.loads((path / "fit.json").read_text())["radiation"]["modes"] == 2
    keys = yaml.safe_load((path / "body.yaml").read_text())
    hashes = [hashlib.sha256((path / name).read_bytes()).hexdigest() for name in ("body.csv", "radiation.csv")]
    assert [keys["provenance"][key]["sha256"] for key in ("body", "outputs.microphones")] == hashes
    source = keys["sources"]["measurement"]
    assert source["text"].startswith('a "b"; measured by ')
    assert source["text"].endswith(f"driven at {', '.join(fitted.responses.references)}; files: x.csv (SHA-256 0)")
    r, measured = fitted.responses, fitted.body.measured
    assert source["changes"].startswith(f"{np.count_nonzero(measured)} modes fitted by ")
    assert source["changes"].endswith(f": {r.freq[0]:g} to {r.freq[-1]:g} Hz, 4 of 5 hits")
    note = keys["provenance"]["body.truncation"]["note"]
    assert note.startswith(f"modes above {r.freq[-1]:g} Hz; {np.count_nonzero(~measured)} rows")
    assert keys["body"]["truncation"]["residual_compliance"] == fitted.body.compliance.tolist()
    # driven at one point, which counts as the middle
    assert keys["body"]["points"]["a"]["u"] == 0.0
    assert keys["body"]["points"]["b"] == {"direction": [0.0, 1.0, 0.0], "u": 0.25}
    assert [o["name"] for o in keys["outputs"]] == ["microphones", "bridge"]
    assert (keys["outputs"][0]["low_cut"], keys["outputs"][0]["full_scale"]) == (12.0, 40.0)
    assert keys["outputs"][1]["at"] == {"mean": [f"body.{name}" for name in r.references]}
    replace(out, radiation=None).write(path)
    assert not any((path / name).exists() for name in ("radiation.csv", "fit.png"))
    assert json.loads((path / "fit.json").read_text())["radiation"] is None
    assert "u" not in yaml.safe_load((path / "body.yaml").read_text())["body"]["points"]["a"]
    with pytest.raises(ZeroDivisionError):
        out.write(tmp_path / "fails", lambda fit, file: 1 / 0)
    assert not (tmp_path / "fails").exists()


@pytest.mark.parametrize(("places", "driven"), [((0.0,), "a"), ((-0.5, 0.5), "ab")])
def test_a_bank_is_that_of_its_pressures(places, driven) -> None:
    """Two poles, one microphone, noise of 1e-5: poles, heave and moment; the high-pass lies at a fifth of 60 Hz."""
    poles = TAU * np.array([200.0, 500.0]) * (-0.5 / np.array([8.0, 60.0]) + 1j)
    heave, moment = np.array([3.0 + 1j, -2.0 + 2j]), np.array([1.0 - 1j, 0.5j])
    s = 1j * TAU * FREQ
    a, b = TAU * 12.0 * np.array([0.8, 1.25])
    rng, heard = np.random.default_rng(7), {}
    for name, u in zip(driven, places, strict=True):
        residues = (heave + u * moment)[:, None]
        bank = (residues / (s - poles[:, None]) + residues.conj() / (s - poles.conj()[:, None])).sum(axis=0)
        error = rng.standard_normal(FREQ.size) + 1j * rng.standard_normal(FREQ.size)
        heard["m", name] = bank * s * s / ((s + a) * (s + b)) + 1e-5 * np.abs(bank).max() * error
    pairs = tuple((name, name) for name in driven)
    given = Responses(FREQ, np.ones((len(pairs), FREQ.size), complex), pairs, pressure=heard)
    body = SimpleNamespace(
        freq=np.array([201.0, 498.0, 900.0]), quality=np.array([35.0, 70.0, 5.0]), measured=np.array([1, 1, 0], bool)
    )
    at = dict(zip(driven, places, strict=True))
    bank = radiation.fit_radiation(given, body, at)
    assert (bank.channels, bank.low_cut) == (("m",), 12.0)
    assert bank.poles == pytest.approx(poles, rel=1e-4)
    assert bank.heave[0] == pytest.approx(heave, rel=1e-3)
    assert bank.moment[0] == pytest.approx(moment if len(places) > 1 else [0, 0], rel=5e-3, abs=1e-12)
    assert bank.error_db.shape == (len(places), FREQ.size)
    assert np.median(np.abs(bank.error_db)) < 0.05
    assert radiation.fit_radiation(replace(given, pressure={}), body, at) is None
    if len(places) > 1:
        with pytest.raises(TonewoodError, match="say where these lie"):
            radiation.fit_radiation(given, body, {"a": 0.3, "b": 0.3})
        with pytest.raises(TonewoodError, match="'m' was not measured from 'b'"):
            radiation.fit_radiation(replace(given, pressure={("m", "a"): heard["m", "a"]}), body, at)


def test_a_picture_leaves_out_what_has_no_deviation_or_lies_beyond_the_band(fitted, monkeypatch, tmp_path) -> None:
    drawn = []
    monkeypatch.setattr(figure, "save", lambda made, path: drawn.append(made))
    row = {"measured": True, "sd_cents": 2.0, "freq_Hz": 200.0, "sd_Q": 0.03}
    rows = [row, row | {"sd_cents": None, "freq_Hz": 210.0}, row | {"measured": False, "freq_Hz": 900.0}]
    fit = SimpleNamespace(rows=rows, responses=fitted.responses, mobility=fitted.mobility, error_db=fitted.error_db)
    figure.draw_fit(fit, tmp_path / "a.png")
    assert [drawn[0].axes[i].lines[0].get_xdata().tolist() for i in (2, 3)] == [[200.0]] * 2
    assert drawn[0].axes[3].lines[0].get_ydata().tolist() == [3.0]


# -- fits again --------------------------------------------------------------------------------------------------------


def test_modes_are_dropped_and_kept_by_frequency() -> None:
    """Of two modes that stand out one is dropped; those that nothing shows are kept where they are wanted."""
    rng, freq = np.random.default_rng(3), np.arange(100.0, 500.0)
    y = np.array([[1.0, 0.8]]) @ resonances(freq, [200.0, 400.0], [40.0, 50.0])
    y = y + 1e-4 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    shape = Shape((0,), 1, True, False, False)

    def freqs(**more):
        poles = identify(freq, y, shape, damping="viscous", **more).poles
        return poles.freq[(poles.freq > 100) & (poles.freq < 499)]

    assert freqs() == pytest.approx([200.0, 400.0], rel=1e-3)
    assert not np.any(np.abs(freqs(drop=[405.0]) - 400.0) < 4.0)
    for wanted in ([300.0], [260.0, 320.0]):
        found = freqs(keep=wanted)
        assert len(found) == 2 + len(wanted)
        assert all(np.abs(found / f - 1).min() < 0.05 for f in wanted)
    for dropped, nearest in ((280.0, r"(199\.99|200)"), (290.0, r"(399\.9|400)")):
        with pytest.raises(LookupError, match=rf"there is no mode at {dropped:g} Hz; the nearest is at {nearest}"):
            identify(freq, y, shape, damping="viscous", drop=[dropped])


@pytest.mark.parametrize(
    ("names", "chosen", "taken"),
    [
        (["X", "frf", "H_psd"], [], "frf"),
        (["s.X", "s.Mobility", "Y_corr"], [], "Mobility"),
        (["X", "frf"], ["X"], "X"),
        (["X"], [], "X"),
    ],
)
def test_of_complex_arrays_that_called_a_response_is_one(names, chosen, taken) -> None:
    freq = np.arange(1.0, 21.0)
    given = {"freq_Hz": freq} | {name: (i + 1j) * freq for i, name in enumerate(names)}
    table = arrays.responses_of_arrays(Path("a.npz"), given, chosen)
    assert list(table.rows) == [(taken, "unnamed")]
    at = next(i for i, name in enumerate(names) if name.endswith(taken))
    assert table.rows[taken, "unnamed"].tolist() == ((at + 1j) * freq).tolist()
    assert table.form == ("mobility" if taken == "Mobility" else None)
