"""Files of measurements: every kind says the same, and a fault of one is reported in one line."""

from __future__ import annotations

import io
import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf
from fit_scenes import random_body

from tonewood.errors import TonewoodError
from tonewood.workshop.fit.arrays import npz_arrays
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.responses import Responses

FREQ = np.arange(50.0, 250.0)
TRUTH = random_body(3, seed=0, high=220.0).noisy(FREQ, 0.01, seed=0)[0]
PAIRS = (("a", "a"), ("b", "a"))


def write_csv(path, polar=False, coherence=False):
    columns, head = [FREQ], ["freq_Hz"]
    for (point, reference), row in zip(PAIRS, TRUTH, strict=True):
        parts = (np.abs(row), np.degrees(np.angle(row))) if polar else (row.real, row.imag)
        for part, values in zip(("mag", "phase") if polar else ("re", "im"), parts, strict=True):
            head.append(f"{point}:{reference}_{part}")
            columns.append(values)
        if coherence:
            head.append(f"{point}:{reference}_coherence")
            columns.append(np.full(FREQ.size, 0.98))
    rows = [",".join(map(repr, map(float, row))) for row in np.array(columns).T]
    path.write_text("\n".join([",".join(head), *rows]) + "\n")
    return path


def test_csv_npz_and_uff_say_the_same(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    rectangular = read_responses([write_csv(tmp_path / "a.csv")], Reading("mobility"))
    polar = read_responses([write_csv(tmp_path / "b.csv", polar=True, coherence=True)], Reading("mobility", n_hits=5))
    np.savez(tmp_path / "c.npz", freq_Hz=FREQ, **{f"{p}:{r}": x for (p, r), x in zip(PAIRS, TRUTH, strict=True)})
    packed = read_responses([tmp_path / "c.npz"], Reading("mobility"))
    universal = pyuff.UFF(str(tmp_path / "d.uff"))
    for (point, _), row in zip(PAIRS, TRUTH, strict=True):
        node = {"a": 1, "b": 2}[point]
        universal.write_sets(
            pyuff.prepare_58(
                func_type=4, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, rsp_ent_name="NONE",
                ref_ent_name="NONE", data=row, x=FREQ, binary=1, id1="", id2="", id3="", id4="", id5="",
                load_case_id=0, abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=11,
                orddenom_spec_data_type=13,
            ),
            mode="add",
        )  # fmt: skip
    binary = read_responses([tmp_path / "d.uff"], Reading())
    assert rectangular.pairs == polar.pairs == packed.pairs == PAIRS
    assert binary.pairs == (("1+3", "1+3"), ("2+3", "1+3"))
    for other in (polar, packed, binary):
        assert np.allclose(other.mobility, rectangular.mobility, rtol=1e-12, atol=0)
        assert np.array_equal(other.freq, FREQ)
    assert polar.coherence is not None
    assert set(rectangular.files) == {"a.csv"}
    with pytest.raises(TonewoodError, match="says mobility while --form says accelerance"):
        read_responses([tmp_path / "d.uff"], Reading("accelerance"))


def test_forms_differ_by_powers_of_s(tmp_path):
    path = write_csv(tmp_path / "a.csv")
    s = 1 / 0.2 + 2j * np.pi * FREQ
    for form, power in (("receptance", 1), ("mobility", 0), ("accelerance", -1)):
        read = read_responses([path], Reading(form, window_tau=0.2))
        assert np.allclose(read.mobility, TRUTH * s**power, rtol=1e-12)


def test_hits_of_wav_and_csv_say_the_same(tmp_path):
    rng, fs, n = np.random.default_rng(1), 4000, 2000
    t = np.arange(n)
    paths = {"wav": [], "csv": []}
    for hit in range(3):
        force = 0.5 * np.exp(-0.5 * ((t - 30) / 3.0) ** 2)
        motion = 0.3 * np.exp(-t / 300) * np.sin(t / (6 + 0.1 * hit)) + 1e-3 * rng.normal(size=n)
        sf.write(tmp_path / f"{hit}.wav", np.stack([force, motion], axis=1), fs, subtype="DOUBLE")
        rows = [
            f"{i / fs!r},{100 * f!r},{50 * m!r}"
            for i, f, m in zip(t.tolist(), force.tolist(), motion.tolist(), strict=True)
        ]
        (tmp_path / f"{hit}.csv").write_text("\n".join(["time_s,a_force,a", *rows]) + "\n")
        paths["wav"].append(tmp_path / f"{hit}.wav")
        paths["csv"].append(tmp_path / f"{hit}.csv")
    reading = Reading("accelerance", points=("a",), references=(("a", ""),), sensitivity=(100.0, 50.0), window_tau=0.1)
    wav, csv = (read_responses(paths[kind], reading) for kind in ("wav", "csv"))
    assert wav.kept == csv.kept == (3, 3)
    assert wav.alpha == pytest.approx(10.0)
    assert np.allclose(wav.mobility[:, 1:], csv.mobility[:, 1:], rtol=1e-9)


def test_a_universal_file_says_its_units_and_its_pressures(tmp_path):
    """In mm (164: 1000 of them per metre) with forces in N, and a pressure in Pa beside it."""
    pyuff = pytest.importorskip("pyuff")
    universal = pyuff.UFF(str(tmp_path / "a.uff"))
    units = {
        "type": 164, "units_code": 5, "units_description": "MM (MILLI-NEWTON)", "temp_mode": 1, "length": 1000.0,
        "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
    }  # fmt: skip
    universal.write_sets(units, mode="add")
    for ordinate, row, node in ((12, 1000 * TRUTH[0], 4), (15, TRUTH[1], 9)):
        universal.write_sets(
            pyuff.prepare_58(
                func_type=4, rsp_node=node, rsp_dir=3 if ordinate == 12 else 0, ref_node=4, ref_dir=3,
                rsp_ent_name="NONE", ref_ent_name="NONE", data=row, x=FREQ, binary=1, id1="", id2="", id3="", id4="",
                id5="", load_case_id=0, abscissa_spacing=1, abscissa_spec_data_type=18,
                ordinate_spec_data_type=ordinate, orddenom_spec_data_type=13,
            ),
            mode="add",
        )  # fmt: skip
    read = read_responses([tmp_path / "a.uff"], Reading())
    assert read.pairs == (("4+3", "4+3"),)
    assert np.allclose(read.mobility[0], TRUTH[0] / (2j * np.pi * FREQ), rtol=1e-12)
    assert np.allclose(read.pressure["9+0", "4+3"], TRUTH[1], rtol=1e-12)


def test_hits_on_two_points(tmp_path):
    """Each file says where it was struck; a WAV by the beginning of its name. Responses of both are kept apart."""
    rng, fs, n = np.random.default_rng(1), 4000, 2000
    t, paths = np.arange(n), []
    for struck, size in (("a", 1.0), ("b", 2.0)):
        for hit in range(2):
            force = 0.5 * np.exp(-0.5 * ((t - 30) / 3.0) ** 2)
            motion = [size * 0.1 * np.exp(-t / 300) * np.sin(t / w) + 1e-4 * rng.normal(size=n) for w in (6, 7)]
            paths.append(tmp_path / f"{struck}_{hit}.wav")
            sf.write(paths[-1], np.stack([force, *motion], axis=1), fs, subtype="DOUBLE")
    where = (("a", "a_"), ("b", "b_"))
    reading = Reading("mobility", points=("a", "b"), references=where, sensitivity=(1.0, 1.0, 1.0))
    read = read_responses(paths, reading)
    assert read.pairs == (("a", "a"), ("b", "a"), ("a", "b"), ("b", "b"))
    assert read.references == ("a", "b")
    assert read.kept == (4, 4)
    assert read.n_hits == 2
    assert read.coherence.shape == (4, n // 2 + 1)
    alone = read_responses(paths[2:], reading)
    assert np.array_equal(read.mobility[2:], alone.mobility)
    with pytest.raises(TonewoodError, match="the point that the hammer struck is not named"):
        read_responses(paths, Reading("mobility", points=("a", "b"), references=where[:1], sensitivity=(1.0, 1.0, 1.0)))


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("freq_Hz,a:a_re,a:a_im\n1,2\n", "2 numbers under 3 columns"),
        ("f,a:a_re,a:a_im\n1,2,3\n", "no column freq_Hz"),
        ("freq_Hz,a:a_re\n1,2\n", "no column a:a_im"),
        ("freq_Hz,a_re,a_im\n1,2,3\n", "POINT:REFERENCE is allowed"),
        ("freq_Hz,a:a_re,a:a_im\n1,x,3\n", "not a finite number"),
        ("", "no rows"),
    ],
)
def test_what_is_wrong_with_a_table_is_reported_in_one_line(tmp_path, text, reported):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(TonewoodError, match=reported) as fault:
        read_responses([path], Reading("mobility"))
    assert "bad.csv" in str(fault.value)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("arrays", "reported"),
    [
        ({"freq_Hz": FREQ.astype(str)}, "freq_Hz: is no row of real numbers"),
        ({"freq_Hz": FREQ + 1j}, "freq_Hz: is no row of real numbers"),
        ({"freq_Hz": np.array(3.0)}, "freq_Hz: is no row of real numbers"),
        ({"freq_Hz": np.full(FREQ.size, np.nan)}, "freq_Hz: holds a value that is not a finite number"),
        ({"a:a": np.array(["a"] * FREQ.size)}, "a:a: is no row of complex numbers"),
        ({"a:a_coherence": TRUTH[0]}, "a:a_coherence: is no row of real numbers"),
    ],
)
def test_what_is_wrong_with_arrays_is_reported_in_one_line(tmp_path, arrays, reported):
    np.savez(tmp_path / "bad.npz", **({"freq_Hz": FREQ, "a:a": TRUTH[0]} | arrays))
    with pytest.raises(TonewoodError, match=f"bad.npz: {reported}"):
        read_responses([tmp_path / "bad.npz"], Reading("mobility"))


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b[:200] + b"x" + b[201:], lambda _: b""])
def test_a_damaged_archive_of_arrays_is_reported_in_one_line(tmp_path, damage):
    path = tmp_path / "bad.npz"
    np.savez(path, **{"freq_Hz": FREQ, "a:a": TRUTH[0]})
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(TonewoodError, match=r"bad\.npz: is no npz file of arrays: ") as fault:
        read_responses([path], Reading("mobility"))
    assert "\n" not in str(fault.value)


def test_what_is_wrong_with_a_measurement_is_reported_in_one_line(tmp_path):
    path = write_csv(tmp_path / "a.csv")
    with pytest.raises(TonewoodError, match="--form: the quantity measured is not stated"):
        read_responses([path], Reading())
    assert "negative real part over" in read_responses([path], Reading("accelerance")).no_body()
    swapped = read_responses([path], Reading("mobility"))
    assert swapped.no_body() is None
    assert "1e-05 to 10000 kg" in type(swapped)(swapped.freq, swapped.mobility * 1e-9, swapped.pairs).no_body()
    transfer = type(swapped)(swapped.freq, swapped.mobility[1:], swapped.pairs[1:])
    assert transfer.no_body().startswith("no driving point: the sensor did not stand where the hammer struck ('a')")
    with pytest.raises(TonewoodError, match="--band"):
        swapped.band(60.0, 70.0)


def test_an_array_that_states_an_absurd_shape_is_one_line(tmp_path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<c16", "fortran_order": False, "shape": (10**14,)})
    with zipfile.ZipFile(tmp_path / "claim.npz", "w") as archive:
        archive.writestr("H.npy", head.getvalue())
    with pytest.raises(TonewoodError, match=r"claim\.npz: is no npz file of arrays"):
        npz_arrays(tmp_path / "claim.npz")


@pytest.mark.parametrize("scale", [1e-9, 1e-30])
def test_stiff_things_are_not_two_sided(tmp_path: Path, scale: float) -> None:
    np.savez(tmp_path / "a.npz", **{"freq_Hz": FREQ, "a:a": scale * TRUTH[0]})
    assert np.array_equal(read_responses([tmp_path / "a.npz"], Reading("mobility")).mobility[0], scale * TRUTH[0])
    both = np.concatenate([TRUTH[0], TRUTH[0, ::-1].conj()])
    np.savez(tmp_path / "b.npz", **{"freq_Hz": np.arange(1.0, 401.0), "a:a": scale * both})
    with pytest.raises(TonewoodError, match="two-sided: from bin 201 on"):
        read_responses([tmp_path / "b.npz"], Reading("mobility"))


def test_frequencies_that_do_not_rise_and_devices_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **{"freq_Hz": FREQ[[1, 0, *range(2, FREQ.size)]], "a:a": TRUTH[0]})
    with pytest.raises(TonewoodError, match=r"a\.npz: freq_Hz: frequencies do not rise"):
        read_responses([tmp_path / "a.npz"], Reading("mobility"))
    os.mkfifo(tmp_path / "b.csv")
    with pytest.raises(TonewoodError, match=r"b\.csv: is a device"):
        read_responses([tmp_path / "b.csv"], Reading("mobility"))


def write_hit(path, n=400, fs=4000, *, forces=1, points=1, zeros=0, size=0.5, seed=0):
    """A force and a decaying tone in noise: CSV with this program's columns, text without a name, or WAV."""
    rng, t = np.random.default_rng(seed), np.arange(n)
    motion = 0.3 * np.exp(-t / 80) * np.sin(t / 6) + 1e-3 * rng.normal(size=n)
    force = size * np.exp(-0.5 * ((t - 30) / 3.0) ** 2)
    columns = np.array([force] * forces + [motion] * points).T
    columns[n - zeros :] = 0.0
    if path.suffix == ".wav":
        sf.write(path, columns, fs, subtype="DOUBLE")
        return path
    names = [f"{'ab'[i]}_force" for i in range(forces)] + ["a", "b"][:points]
    head = "time_s," + ",".join(names) if path.suffix == ".csv" else ""
    np.savetxt(path, np.column_stack([t / fs, columns]), delimiter="," if head else "\t", header=head, comments="")
    return path


HITS = Reading("mobility", points=("a",), references=(("a", ""),), sensitivity=(1.0, 1.0))


@pytest.mark.parametrize(
    ("made", "reported"),
    [
        (lambda at: [], "FILES: no file was given"),
        (lambda at: [at / "no.npz"], r"no\.npz: cannot be read: No such file"),
        (lambda at: [write_hit(at / "a.csv"), write_hit(at / "b.csv", n=300)], r"b\.csv: has another rate, length or"),
        (lambda at: [write_hit(at / "a.csv"), write_hit(at / "b.csv", fs=3000)], r"b\.csv: has another rate, length"),
        (lambda at: [write_hit(at / "a.csv"), write_hit(at / "b.csv", points=2)], r"b\.csv: has another .* channels"),
        (lambda at: [write_hit(at / "a.csv", zeros=40)], r"a\.csv: ends in zeros"),
        (lambda at: [write_hit(at / "a.csv", forces=2)], r"a\.csv: wants one column REFERENCE_force and one or more"),
        (lambda at: [write_hit(at / "a.csv", points=0)], r"a\.csv: wants one column REFERENCE_force and one or more"),
        (lambda at: [write_hit(at / "a.wav", n=0)], r"a\.wav: holds no samples"),
        (lambda at: [write_hit(at / "a.wav", size=1.0)], r"a\.wav: is clipped: samples of channel 1 reach full scale"),
        (lambda at: [write_csv(at / "a.csv").rename(at / "a.wav")], r"a\.wav: is no sound file: "),
        (
            lambda at: [write_csv(at / "a.csv"), write_hit(at / "b.csv")],
            r"FILES: files of different kinds \(csv, hits\)",
        ),
    ],
)
def test_what_is_wrong_with_hits_is_reported_in_one_line(tmp_path: Path, made, reported) -> None:
    with pytest.raises(TonewoodError, match=reported) as fault:
        read_responses(made(tmp_path), HITS)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("arrays", "reported"),
    [
        ({"freq_Hz": FREQ + 1, "b:a": TRUTH[1]}, r"b\.npz: freq_Hz: has other frequencies than the first file"),
        ({"freq_Hz": FREQ[1:], "b:a": TRUTH[1, 1:]}, r"b\.npz: freq_Hz: has other frequencies than the first file"),
        ({"freq_Hz": FREQ, "b:a": TRUTH[1, :3]}, r"b\.npz: b:a: has the shape \(3,\); \(200,\) is allowed"),
    ],
)
def test_files_of_other_frequencies_are_no_one_measurement(tmp_path: Path, arrays, reported) -> None:
    np.savez(tmp_path / "a.npz", **{"freq_Hz": FREQ, "a:a": TRUTH[0]})
    np.savez(tmp_path / "b.npz", **arrays)
    with pytest.raises(TonewoodError, match=reported):
        read_responses([tmp_path / "a.npz", tmp_path / "b.npz"], Reading("mobility"))


def test_a_text_over_time_is_a_hit_and_one_hit_has_no_coherence(tmp_path: Path) -> None:
    paths = [write_hit(tmp_path / f"{i}.txt", seed=i) for i in range(2)]
    tables = [write_hit(tmp_path / f"{i}.csv", seed=i) for i in range(2)]
    unscaled = replace(HITS, sensitivity=())
    two, same = (read_responses(files, unscaled) for files in (paths, tables))
    np.testing.assert_allclose(two.mobility, same.mobility, rtol=1e-9)
    assert (two.n_hits, two.kept, two.remarks) == (2, (2, 2), ())
    assert two.coherence is not None
    one = read_responses(paths[:1], replace(HITS, sensitivity=(2.0, 3.0)))
    assert (one.coherence, one.n_hits, one.kept) == (None, None, (1, 1))
    assert one.remarks == ("one hit at a: its noise is taken from the roughness of the response; five tell more",)
    single = read_responses(paths[:1], unscaled)
    np.testing.assert_allclose(one.mobility, 1.5 * single.mobility, rtol=1e-9)
    assert repr(single) == "<Responses of 1 pairs, 0 microphones, 201 bins, 0 to 2000 Hz>"
    with pytest.raises(TonewoodError, match=r"holds a record over time, of 0\.0998 s, of a force and 1 responses"):
        read_responses(paths, Reading("mobility"))
    with pytest.raises(TonewoodError, match="--form: the quantity measured is not stated"):
        read_responses(paths, replace(HITS, form=None))


def test_bins_of_0_were_not_measured(tmp_path: Path) -> None:
    masked = TRUTH.copy()
    masked[1, 100:160] = 0.0
    np.savez(
        tmp_path / "a.npz", **{"freq_Hz": FREQ, **{f"{p}:{r}": x for (p, r), x in zip(PAIRS, masked, strict=True)}}
    )
    responses = read_responses([tmp_path / "a.npz"], Reading("mobility"))
    fit = fit_responses(responses)
    assert (fit.empty, fit.responses.freq.size) == (60, FREQ.size - 60)
    assert np.isfinite(fit.error_db).all()
    for scale in (1e300, 1e-200):
        with pytest.raises(TonewoodError, match=r"not between 1e-30 and 1e\+30"):
            fit_responses(replace(responses, mobility=scale * TRUTH))


def test_a_response_that_is_given_twice_is_refused_in_one_line(tmp_path):
    """Of two values of one pair none is chosen: in two files, two data sets, two spellings, two forms."""
    row, other = TRUTH[0], 2 * TRUTH[0]
    for folder, values in (("one", row), ("two", other)):
        (tmp_path / folder).mkdir()
        np.savez(tmp_path / folder / "p.npz", freq_Hz=FREQ, **{"a:a": values})
    np.savez(tmp_path / "spelt.npz", freq_Hz=FREQ, **{"a:a": row, "a__a": other})
    np.savez(tmp_path / "parts.npz", freq_Hz=FREQ, **{"a:a": row, "a:a_re": other.real, "a:a_im": other.imag})
    cases = [
        ([tmp_path / "one" / "p.npz", tmp_path / "two" / "p.npz"], "p.npz: a:a: is in another file, too"),
        ([tmp_path / "one" / "p.npz", tmp_path / "one" / "p.npz"], "has the same content as"),
        ([tmp_path / "spelt.npz"], "a:a: is in it as a__a, too"),
        ([tmp_path / "parts.npz"], "a:a: is in it in two forms"),
    ]
    for paths, reported in cases:
        with pytest.raises(TonewoodError) as fault:
            read_responses(paths, Reading("mobility"))
        assert reported in str(fault.value)
        assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("sets", "reported"),
    [(((1, 11), (1, 11)), "1+3:1+3: is in it twice"), (((1, 11), (2, 12)), "quantities: accelerance, mobility")],
)
def test_data_sets_that_contradict_each_other_are_refused(tmp_path, sets, reported):
    pyuff = pytest.importorskip("pyuff")
    universal = pyuff.UFF(str(tmp_path / "d.uff"))
    for node, ordinate in sets:
        universal.write_sets(
            pyuff.prepare_58(
                func_type=4, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, rsp_ent_name="NONE",
                ref_ent_name="NONE", data=TRUTH[0], x=FREQ, binary=1, id1="", id2="", id3="", id4="", id5="",
                load_case_id=0, abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=ordinate,
                orddenom_spec_data_type=13,
            ),
            mode="add",
        )  # fmt: skip
    with pytest.raises(TonewoodError) as fault:
        read_responses([tmp_path / "d.uff"], Reading("mobility"))
    assert reported in str(fault.value)


@pytest.mark.parametrize("value", [98.0, -0.1, np.nan])
def test_coherences_outside_0_and_1_are_refused(tmp_path, value):
    coherence = np.where(FREQ == 100.0, value, 0.9)
    np.savez(tmp_path / "a.npz", freq_Hz=FREQ, **{"a:a": TRUTH[0], "a:a_coherence": coherence})
    with pytest.raises(TonewoodError, match="from 0 to 1"):
        read_responses([tmp_path / "a.npz"], Reading("mobility", n_hits=5)).checked()


def test_responses_of_nothing_are_not_called_real(tmp_path):
    np.savez(tmp_path / "a.npz", freq_Hz=FREQ, **{"a:a": 0j * FREQ})
    with pytest.raises(TonewoodError, match="hold values that are not finite numbers, or the largest"):
        fit_responses(read_responses([tmp_path / "a.npz"], Reading("mobility")))
    np.savez(tmp_path / "b.npz", freq_Hz=FREQ[:0], **{"a:a": 0j * FREQ[:0]})
    with pytest.raises(TonewoodError, match="freq_Hz: holds no bins"):
        read_responses([tmp_path / "b.npz"], Reading("mobility"))


@pytest.mark.parametrize(
    ("keep", "drop", "reported"),
    [(400.0, (), "400 Hz lies outside 50 to 249"), (60.0, (60.0,), "60 Hz is to be dropped, too")],
)
def test_a_mode_that_is_kept_lies_in_the_band_and_is_not_dropped(keep, drop, reported):
    with pytest.raises(TonewoodError, match=reported):
        fit_responses(Responses(FREQ, TRUTH[:1], PAIRS[:1]), keep=(keep,), drop=drop)


def test_bins_below_0_hz_are_left_out_and_counted(tmp_path):
    np.savez(tmp_path / "a.npz", freq_Hz=FREQ - 60.0, **{"a:a": TRUTH[0]})
    read = read_responses([tmp_path / "a.npz"], Reading("mobility"))
    assert read.remarks == ("10 bins of frequencies below 0 were left out",)
    assert read.band(None, None).freq.tolist() == list(range(1, 190))
