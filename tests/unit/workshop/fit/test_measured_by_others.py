"""What other people's files hold: other damping, other ways to measure, other formats, and faults of a channel."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf
from fit_scenes import TAU

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.responses import Responses
from tonewood.workshop.fit.stability import stability

FREQ = np.arange(20.0, 600.0)
NATURAL, MASS = np.array([103.0, 196.0, 325.0]), np.array([0.1, 0.2, 0.15])
SHAPES = np.array([[1, 1, 1], [1, -0.5, 0.8], [1, 0.7, -0.6]])
NAMES = ("p0", "p1", "p2")


def mobility(structural=False, relative=0.0, additive=0.0, seed=1):
    """(3, N) of three points driven at the first; Q or 1/eta is 30."""
    rng, w, wn = np.random.default_rng(seed), TAU * FREQ, TAU * NATURAL[:, None]
    loss = 1j * wn**2 / 30 if structural else 1j * w * wn / 30
    clean = (SHAPES * SHAPES[0] / MASS) @ (1j * w / (wn**2 - w**2 + loss))
    size = relative * np.abs(clean) + additive * np.abs(clean).max()
    return clean + size / np.sqrt(2) * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))


def measured(fit):
    return [row for row in fit.rows if row["measured"]]


def command(*words):
    with pytest.raises(SystemExit) as ended:
        run([str(word) for word in words])
    return ended.value.code


@pytest.mark.parametrize("structural", [False, True], ids=["viscous", "structural"])
@pytest.mark.parametrize(
    ("relative", "additive"),
    [
        (0.0, 0.0),
        (3e-3, 1e-4),
        *(pytest.param(*noise, marks=pytest.mark.slow) for noise in [(1e-3, 0.0), (1e-2, 0.0), (0.0, 1e-3)]),
    ],
)
def test_three_modes_are_three_whatever_noise_and_damping(structural, relative, additive):
    fit = fit_responses(Responses(FREQ, mobility(structural, relative, additive), tuple((p, "p0") for p in NAMES)))
    rows = measured(fit)
    assert len(rows) == 3
    assert [row["freq_Hz"] for row in rows] == pytest.approx(NATURAL, rel=1e-3)
    assert [row["Q"] for row in rows] == pytest.approx([30.0] * 3, rel=0.03)
    assert [row["mass_kg"] for row in rows] == pytest.approx(MASS, rel=0.03)
    assert min(row["mpc"] for row in rows) > 0.99
    assert fit.facts()["damping"] == ("structural" if structural else "viscous")
    assert fit.modes.misfit < 1.1


@pytest.mark.parametrize("kind", ["rel", pytest.param("sensor moves", marks=pytest.mark.slow), "no driving point"])
def test_a_hammer_that_goes_about_tells_what_a_sensor_does_that_does(kind):
    rows = mobility(relative=1e-3)
    pairs = tuple(("p0", p) if kind != "sensor moves" else (p, "p0") for p in NAMES)
    if kind == "no driving point":
        rows, pairs = rows[1:], pairs[1:]
    fit = fit_responses(Responses(FREQ, rows, pairs))
    assert [row["freq_Hz"] for row in measured(fit)] == pytest.approx(NATURAL, rel=1e-3)
    if kind != "no driving point":
        assert fit.body.points[0] == "p0"
        shapes = np.array([row["shape"] for row in measured(fit)])
        assert np.allclose(np.abs(shapes.T), np.abs(SHAPES / np.sqrt(MASS)), rtol=0.02)
        return
    assert fit.body is None
    assert fit.no_body.startswith("no driving point: the sensor did not stand where the hammer struck")
    for k, row in enumerate(measured(fit)):
        one, other = (complex(*x) for x in row["shape"])
        assert (one / other).real == pytest.approx(SHAPES[1, k] / SHAPES[2, k], rel=0.02)
        assert row["Q"] == pytest.approx(30.0, rel=0.03)


def test_a_sensor_beside_the_hammer_is_the_first_cause_named():
    """The transfer p1:p0 called a driving point: negative real parts, modes all the same."""
    fit = fit_responses(Responses(FREQ, mobility(relative=1e-3)[1:2], (("a", "a"),)))
    causes = fit.no_body.split("likely causes: ")[1].split(", ")
    assert causes[0] == "the sensor did not stand where the hammer struck"
    assert [row["freq_Hz"] for row in measured(fit)] == pytest.approx(NATURAL, rel=1e-3)


def test_the_conjugate_of_a_response_is_refused_in_one_line():
    """Files for exp(-jwt): real parts are those of a body, but nothing that decays turns the phase so."""
    pairs = tuple((p, "p0") for p in NAMES)
    with pytest.raises(TonewoodError, match="imaginary parts of the other sign") as fault:
        fit_responses(Responses(FREQ, mobility(relative=1e-3).conj(), pairs))
    assert "\n" not in str(fault.value)


def test_coherences_that_are_no_numbers_are_refused_in_one_line():
    pairs = tuple((p, "p0") for p in NAMES)
    with pytest.raises(TonewoodError, match="without --hits they are not used"):
        fit_responses(Responses(FREQ, mobility(), pairs, np.full((3, FREQ.size), np.nan), 5))


@pytest.mark.parametrize(
    ("factor", "each"), [(3.0, True), *(pytest.param(x, False, marks=pytest.mark.slow) for x in [3.0, 0.0, 30j])]
)
def test_single_bins_that_are_wrong_are_left_out_and_make_no_mode(factor, each):
    """Twelve bins of all responses, or six of each, at three times their size, at 0, or at thirty times, turned."""
    rows, rng, wrong = mobility(relative=1e-3, additive=1e-4), np.random.default_rng(5), np.zeros((3, FREQ.size), bool)
    for row in wrong if each else [wrong]:
        row[..., rng.integers(0, FREQ.size, 6 if each else 12)] = True
    rows[wrong] *= factor
    fit = fit_responses(Responses(FREQ, rows, tuple((p, "p0") for p in NAMES)))
    assert [row["freq_Hz"] for row in measured(fit)] == pytest.approx(NATURAL, rel=1e-3)
    assert [row["Q"] for row in measured(fit)] == pytest.approx([30.0] * 3, rel=0.03)
    assert [row["mass_kg"] for row in measured(fit)] == pytest.approx(MASS, rel=0.03)
    assert set(fit.outliers) <= set(FREQ[wrong.any(axis=0)])
    said = "disagree with their neighbours" if factor else "12 bins without a finite number, or with 0, were left out"
    assert any(said in line for line in fit.warnings)


@pytest.mark.slow
def test_bins_without_numbers_and_frequencies_in_khz_are_said():
    rows, pairs = mobility(relative=1e-3), tuple((p, "p0") for p in NAMES)
    rows[:, 100:105] = np.nan
    fit = fit_responses(Responses(1e-3 * FREQ, rows, pairs))
    assert any("kHz read as Hz, perhaps" in line for line in fit.warnings)
    assert "5 bins without a finite number, or with 0, were left out" in fit.warnings


@pytest.mark.slow
def test_a_body_lighter_than_any_is_a_matter_of_units():
    rows = 1e3 * mobility(relative=1e-3)
    fit = fit_responses(Responses(FREQ, rows, tuple((p, "p0") for p in NAMES)))
    assert any("mm/s read as m/s (--scale 1e-3)" in line for line in fit.warnings)
    assert not any("mm/s" in line for line in fit_responses(Responses(FREQ, 1e-3 * rows, fit.responses.pairs)).warnings)


@pytest.mark.parametrize(
    "kind",
    [
        "complex64",
        "bins missing",
        *(pytest.param(x, marks=pytest.mark.slow) for x in ["g per N", "two close modes", "exponential window"]),
    ],
)
def test_other_peoples_arrays_are_three_modes(tmp_path, kind):
    """Units by --scale, short numbers, modes within 1.5 %, a window known to the fit, bins that are no numbers."""
    natural, alpha, reading = NATURAL.copy(), 0.0, Reading("mobility")
    if kind == "two close modes":
        natural[0] = 193.0
    if kind == "exponential window":
        alpha, reading = 10.0, Reading("mobility", window_tau=0.1)
    s, w = alpha + 1j * TAU * FREQ, TAU * natural[:, None]
    rng, clean = np.random.default_rng(4), (SHAPES * SHAPES[0] / MASS) @ (s / (s * s + w * s / 30 + w * w))
    rows = clean * (1 + 1e-3 * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape)))
    if kind == "g per N":
        rows, reading = rows * 2j * np.pi * FREQ / 9.80665, Reading("accelerance", scale=9.80665)
    if kind == "complex64":
        rows = rows.astype(np.complex64)
    if kind == "bins missing":
        rows[:, 100:105] = np.nan
    np.savez(tmp_path / "a.npz", freq_Hz=FREQ, **{f"{p}:p0": row for p, row in zip(NAMES, rows, strict=True)})
    found = measured(fit_responses(read_responses([tmp_path / "a.npz"], reading)))
    assert [row["freq_Hz"] for row in found] == pytest.approx(natural, rel=1e-3)
    assert [row["Q"] for row in found] == pytest.approx([30.0] * 3, rel=0.03)
    assert [row["mass_kg"] for row in found] == pytest.approx(MASS, rel=0.03)


def test_directions_of_a_universal_file_turn_signs(tmp_path):
    """Sensor upside down (-Z) on the node that was struck in +Z: the same driving point with the other sign."""
    pyuff = pytest.importorskip("pyuff")
    rows, universal = mobility(), pyuff.UFF(str(tmp_path / "a.uff"))
    ways = ((1, -3, -rows[0]), (2, 3, rows[1]), (3, -1, -rows[2]))
    for node, direction, row in ways:
        universal.write_sets(
            pyuff.prepare_58(
                func_type=4, rsp_node=node, rsp_dir=direction, ref_node=1, ref_dir=3, rsp_ent_name="NONE",
                ref_ent_name="NONE", data=row, x=FREQ, binary=1, id1="", id2="", id3="", id4="", id5="",
                load_case_id=0, abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=11,
                orddenom_spec_data_type=13,
            ),
            mode="add",
        )  # fmt: skip
    read = read_responses([tmp_path / "a.uff"], Reading())
    assert read.pairs == (("1+3", "1+3"), ("2+3", "1+3"), ("3+1", "1+3"))
    assert np.allclose(read.mobility, rows, rtol=1e-9)
    assert read.no_body() is None


@pytest.mark.parametrize("binary", [0, 1])
def test_a_universal_file_that_was_cut_off_says_where(tmp_path, binary):
    pyuff = pytest.importorskip("pyuff")
    universal, path = pyuff.UFF(str(tmp_path / "a.uff")), tmp_path / "a.uff"
    for node, row in enumerate(mobility(), start=1):
        universal.write_sets(
            pyuff.prepare_58(
                func_type=4, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, rsp_ent_name="NONE", ref_ent_name="NONE",
                data=row, x=FREQ, binary=binary, id1="", id2="", id3="", id4="", id5="", load_case_id=0,
                abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=11, orddenom_spec_data_type=13,
            ),
            mode="add",
        )  # fmt: skip
    whole = path.read_bytes()
    assert len(read_responses([path], Reading()).pairs) == 3
    for kept, said in ((0.55, "data set 2 (response at node 2 to node 1)"), (0.97, "data set 3 (response at node 3")):
        path.write_bytes(whole[: int(kept * len(whole))])
        with pytest.raises(TonewoodError, match="is cut off") as fault:
            read_responses([path], Reading())
        assert said in str(fault.value)
        assert "\n" not in str(fault.value)


def test_sets_that_are_missing_or_say_no_phase_or_rad_per_s_are_said(tmp_path):
    pyuff = pytest.importorskip("pyuff")

    def read(nodes, factor=1.0, magnitude=False, unit="Hz"):
        (tmp_path / "a.uff").unlink(missing_ok=True)
        for node in nodes:
            data = mobility()[node % 3]
            pyuff.UFF(str(tmp_path / "a.uff")).write_sets(
                pyuff.prepare_58(
                    func_type=4, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, rsp_ent_name="NONE",
                    ref_ent_name="NONE", data=np.abs(data) if magnitude else data, x=factor * FREQ, binary=0, id1="",
                    id2="", id3="", id4="", id5="", load_case_id=0, abscissa_spacing=1, abscissa_spec_data_type=18,
                    ordinate_spec_data_type=11, orddenom_spec_data_type=13, abscissa_axis_units_lab=unit,
                ),
                mode="add",
            )  # fmt: skip
        return read_responses([tmp_path / "a.uff"], Reading())

    assert read((1, 2, 3)).remarks == ()
    pyuff.UFF(str(tmp_path / "b.uff")).write_sets(
        pyuff.prepare_58(
            func_type=1, rsp_node=1, rsp_dir=3, ref_node=1, ref_dir=3, rsp_ent_name="NONE", ref_ent_name="NONE",
            data=np.sin(FREQ), x=FREQ, binary=0, id1="", id2="", id3="", id4="", id5="", load_case_id=0,
            abscissa_spacing=1, abscissa_spec_data_type=17, ordinate_spec_data_type=12, orddenom_spec_data_type=0,
        )
    )  # fmt: skip
    with pytest.raises(TonewoodError, match="its 1 sets 58 are of: time response"):
        read_responses([tmp_path / "b.uff"], Reading())
    assert read((1, 2, 3, 6)).remarks == ("a.uff has no response at 2 of its nodes: 4, 5; sets may be missing",)
    with pytest.raises(TonewoodError, match="is real: magnitudes without phase"):
        read((1, 2), magnitude=True)
    with pytest.raises(TonewoodError, match="frequencies are in rad/s"):
        read((1, 2), factor=TAU, unit="rad/s")


def test_arrays_of_any_name_in_mat_and_npz(tmp_path):
    from scipy.io import savemat

    rows = mobility()
    savemat(tmp_path / "a.mat", {"Freq": FREQ, "Recep": (rows / (2j * np.pi * FREQ)).T, "dt": 0.1})
    savemat(tmp_path / "b.mat", {"test": {"f": FREQ, "FRF": rows[:, :, None]}})
    savemat(tmp_path / "c.mat", {"freq_Hz": FREQ, **{f"{p}__p0": row for p, row in zip(NAMES, rows, strict=True)}})
    parts = {
        f"{p}:p0_{k}": x for p, row in zip(NAMES, rows, strict=True) for k, x in (("re", row.real), ("im", row.imag))
    }
    np.savez(tmp_path / "d.npz", freq_Hz=FREQ, **parts)
    a = read_responses([tmp_path / "a.mat"], Reading(references=(("Recep_1", ""),)))
    assert a.pairs == (("Recep_1", "Recep_1"), ("Recep_2", "Recep_1"), ("Recep_3", "Recep_1"))
    b, c, d = (read_responses([tmp_path / name], Reading("mobility")) for name in ("b.mat", "c.mat", "d.npz"))
    assert b.pairs == (("FRF_1", "unnamed"), ("FRF_2", "unnamed"), ("FRF_3", "unnamed"))
    assert c.pairs == d.pairs == tuple((p, "p0") for p in NAMES)
    for read in (a, b, c, d):
        assert np.allclose(read.mobility, rows, rtol=1e-9)


def test_several_arrays_that_are_named_are_read_together(tmp_path):
    rows = mobility()
    np.savez(tmp_path / "a.npz", Freq=FREQ, H=rows[0], FRF=rows[1], other=rows[2])
    read = read_responses([tmp_path / "a.npz"], Reading("mobility", arrays=("FRF", "other"), references=(("FRF", ""),)))
    assert read.pairs == (("FRF", "FRF"), ("other", "FRF"))
    assert np.allclose(read.mobility, rows[1:], rtol=1e-12)
    with pytest.raises(TonewoodError, match="'G' is no complex array of 580 bins; H, FRF, other"):
        read_responses([tmp_path / "a.npz"], Reading("mobility", arrays=("FRF", "G")))


@pytest.mark.parametrize(
    ("arrays", "reported"),
    [
        ({"Freq": FREQ, "H": FREQ + 0j, "FRF": FREQ + 1j}, "--array: which array holds responses is not clear: H, FRF"),
        ({"Freq": FREQ}, "holds no complex array of 580 bins, as many as Freq has"),
        ({"t": FREQ, "H": FREQ + 0j}, "has no array freq_Hz; there are t"),
        ({"freq": FREQ, "frequency": FREQ, "H": FREQ + 0j}, "which are the frequencies: freq, frequency"),
    ],
)
def test_what_is_not_clear_of_arrays_is_reported_in_one_line(tmp_path, arrays, reported):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {name: x.reshape(-1) for name, x in arrays.items()})
    with pytest.raises(TonewoodError, match=reported.replace("?", r"\?")) as fault:
        read_responses([tmp_path / "a.mat"], Reading("mobility"))
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("content", [b"", b"MATLAB 7.3 MAT-file" + b" " * 200, bytes(range(256)) * 4])
def test_a_damaged_mat_file_is_reported_in_one_line(tmp_path, content):
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(TonewoodError, match=r"a\.mat: is no MATLAB file") as fault:
        read_responses([tmp_path / "a.mat"], Reading("mobility"))
    assert "\n" not in str(fault.value)


@pytest.mark.slow
def test_a_line_of_the_mains_is_no_mode():
    rows = mobility(relative=1e-3)
    rows[:, 30] += 20 * np.abs(rows[:, 30])  # 50 Hz
    fit = fit_responses(Responses(FREQ, rows, tuple((p, "p0") for p in NAMES)))
    assert len(measured(fit)) == 3
    assert any("disagree with their neighbours were left out, 1: 50 Hz" in line for line in fit.warnings)


@pytest.mark.slow
def test_modes_are_dropped_and_kept_by_frequency():
    responses = Responses(FREQ, mobility(relative=1e-3), tuple((p, "p0") for p in NAMES))
    assert [row["freq_Hz"] for row in measured(fit_responses(responses, drop=(196.5,)))] == pytest.approx(
        [103.0, 325.0], rel=0.02
    )
    with pytest.raises(TonewoodError, match="--drop: there is no mode at 250 Hz; the nearest is at"):
        fit_responses(responses, drop=(250.0,))


@pytest.mark.slow
def test_a_mode_whose_absence_nobody_would_see_is_dropped_unless_it_is_wanted():
    """A mode at 250 Hz that turns the response by 0.3 % (0.03 dB) or by 30 %, far above the noise."""
    w, wn = TAU * FREQ, TAU * 250.0
    peak = 1j * w * wn / 30 / (wn**2 - w**2 + 1j * w * wn / 30)  # 1 at its frequency
    rows, at = mobility(additive=1e-6), int(np.argmin(np.abs(FREQ - 250.0)))
    for share, keep, count in ((0.003, (), 3), (0.003, (250.0,), 4), (0.3, (), 4)):
        more = rows + share * np.abs(rows[:, at : at + 1]) * peak
        fit = fit_responses(Responses(FREQ, more, tuple((p, "p0") for p in NAMES)), keep=keep)
        assert len(measured(fit)) == count


def test_physical_poles_are_stable_in_the_chart():
    chart = stability(FREQ, mobility(relative=1e-3))
    for f in NATURAL:
        near = chart.stable & (np.abs(chart.freq / f - 1) < 0.002)
        assert np.unique(chart.order[near]).size >= 12
        assert np.median(chart.quality[near]) == pytest.approx(30.0, rel=0.05)


@pytest.mark.slow
def test_files_of_a_fit_without_a_body(tmp_path, monkeypatch, capsys):
    """Modes, facts and figure; parts of an earlier body do not stay beside them, and `new` says what is missing."""
    monkeypatch.chdir(tmp_path)
    rows = mobility(relative=1e-3)
    for name, first in (("body.npz", 0), ("transfer.npz", 1)):
        np.savez(name, freq_Hz=FREQ, **{f"{p}:p0": row for p, row in list(zip(NAMES, rows, strict=True))[first:]})
        assert command("fit", name, "--form", "mobility", "-o", "fitted") == 0
    said = capsys.readouterr().err
    assert "no passive body: no driving point: the sensor did not stand where the hammer struck ('p0')" in said
    assert sorted(path.name for path in Path("fitted").iterdir()) == ["fit.json", "fit.png", "modes.csv"]
    facts = json.loads(Path("fitted/fit.json").read_text())
    assert facts["modes"][0]["interval_90"]["Q"][0] < 30 < facts["modes"][0]["interval_90"]["Q"][1]
    assert command("new", "mine", "--from", "fitted") == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_the_way_from_a_file_of_another_program_to_a_sound(tmp_path, monkeypatch):
    """A .mat file as the public one below, three receptances beside their frequencies, to a bundle that plays."""
    from scipy.io import savemat

    monkeypatch.chdir(tmp_path)
    savemat("a.mat", {"Freq": FREQ, "Recep": (mobility(relative=1e-3) / (2j * np.pi * FREQ)).T})
    assert command("fit", "a.mat", "--driving", "Recep_1", "-o", "three") == 0
    assert command("new", "mine", "--from", "three") == 0
    tw.write_midi(tw.Score([tw.Note(0.0, 0.3, note=45)]), tmp_path / "a.mid")
    assert command("render", "a.mid", "-i", "mine", "-o", "a.wav", "--max-duration", "0.3") == 0
    assert np.abs(sf.read("a.wav")[0]).max() > 0


def public(name):
    """A data file of the package vibrationtesting, where it is installed."""
    spec = importlib.util.find_spec("vibrationtesting")
    if spec is None or spec.origin is None:
        pytest.skip("needs: pip install --no-deps vibrationtesting")
    return Path(spec.origin).parent / "data" / name


def test_the_way_from_a_public_file_to_a_sound(tmp_path, monkeypatch):
    """As docs/measured_by_others.md shows it: three responses of 0 to 0.4 Hz, called kHz, to a bundle that plays."""
    file = public("mckiddat.mat")
    monkeypatch.chdir(tmp_path)
    assert command("fit", file, "--driving", "Recep_1", "-o", "three") == 0
    assert command("new", "mine", "--from", "three") == 0
    tw.write_midi(tw.Score([tw.Note(0.0, 0.3, note=45)]), tmp_path / "a.mid")
    assert command("render", "a.mid", "-i", "mine", "-o", "a.wav", "--max-duration", "0.3") == 0
    assert np.abs(sf.read("a.wav")[0]).max() > 0


@pytest.mark.parametrize(("name", "freq", "quality"), [("case1.mat", 212.09, 566.0), ("case2.mat", 192.4, None)])
def test_public_files_of_one_transfer(name, freq, quality):
    """The package's own estimates: `sdof_cf` 212.0925 Hz, `mdof_cf` 192.59 Hz (its documentation)."""
    fit = fit_responses(read_responses([public(name)], Reading("receptance")))
    assert fit.body is None
    assert len(measured(fit)) <= 8
    row = min(measured(fit), key=lambda row: abs(row["freq_Hz"] - freq))
    assert row["freq_Hz"] == pytest.approx(freq, abs=0.3)
    if quality is not None:
        assert row["Q"] == pytest.approx(quality, rel=0.1)


def yielding():
    """Structural damping, two modes in one bandwidth, frequencies that fall with motion: no linear modes fit."""
    w, natural = TAU * FREQ, np.append(NATURAL, 106.0)
    shapes, mass = np.column_stack([SHAPES, [1, 0.6, -0.4]]), np.append(MASS, 0.12)
    size = np.abs(mobility())
    fallen = TAU * natural[:, None, None] * (1 - 0.01 * size / size.max())
    own = 1j * w / (fallen**2 * (1 + 1j / 30) - w**2)
    return np.einsum("km,mkn->kn", shapes * shapes[0] / mass, own)


def by_kernel(path, reading):
    """Damping, misfit, and frequencies and Q of the modes, in processes with other kernels of OpenBLAS."""
    code = f"""
import json
from pathlib import Path
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses
facts = fit_responses(read_responses([Path({str(path)!r})], {reading!r})).facts()
rows = [row for row in facts["modes"] if row["measured"]]
print(json.dumps([facts["damping"], facts["misfit"], [r["freq_Hz"] for r in rows], [r["Q"] for r in rows]]))
"""
    for kernel in ("Haswell", "Zen", "SkylakeX", "Prescott"):
        there = os.environ | {"OPENBLAS_CORETYPE": kernel}
        done = subprocess.run([sys.executable, "-c", code], env=there, capture_output=True, text=True)
        if done.returncode != -signal.SIGILL:  # this processor has the kernel's instructions
            assert done.returncode == 0, done.stderr
            yield json.loads(done.stdout)


def assert_alike(found):
    """The same verdict, frequencies and Q far within the doubt of them."""
    assert len(found) > 1
    damping, misfit, freq, quality = found[0]
    for other in found[1:]:
        assert other[0] == damping
        assert other[1] == pytest.approx(misfit, rel=1e-3)
        assert other[2] == pytest.approx(freq, rel=1e-6)
        assert other[3] == pytest.approx(quality, rel=1e-3)


@pytest.mark.slow
def test_the_verdict_does_not_depend_on_the_kernel_of_blas(tmp_path):
    """The misfit is far above the noise: what is kept there is decided by the data, not by rounding."""
    np.savez(tmp_path / "yielding.npz", freq_Hz=FREQ, mobility=yielding())
    found = list(by_kernel(tmp_path / "yielding.npz", Reading("mobility")))
    assert found[0][1] > 2
    assert_alike(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reading"),
    [("case1.mat", Reading("receptance")), ("case2.mat", Reading("receptance"))],
)
def test_verdicts_on_public_files_do_not_depend_on_the_kernel_of_blas(name, reading):
    """Two files on whose order of rounding the verdict once depended."""
    assert_alike(list(by_kernel(public(name), reading)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_verdict_does_not_depend_on_the_last_digits(seed):
    """Data changed by 1e-13, more than another order of sums changes them."""
    rng, clean = np.random.default_rng(seed), yielding()
    found = []
    for response in (clean, clean * (1 + 1e-13 * rng.normal(size=clean.shape))):
        fit = fit_responses(Responses(FREQ, response, tuple((p, "p0") for p in NAMES)))
        rows = measured(fit)
        values = [[row[key] for row in rows] for key in ("freq_Hz", "Q")]
        found.append([fit.modes.structural, fit.modes.misfit, *values])
    assert_alike(found)
