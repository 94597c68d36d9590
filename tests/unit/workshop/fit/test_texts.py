"""Tables that other programs export: heads, signs that separate, decimal commas; and arrays without frequencies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tonewood.errors import TonewoodError
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.texts import _polar, record_of_text

FREQ = np.arange(20.0, 120.0)
VALUES = (np.array([[1.0], [0.3]]) + 0.01 * FREQ) * np.exp(0.02j * FREQ)
UNITS = ";".join(["(m/s^2)/N"] * 4)
HEAD = f"Format;Spectrum\nSignals;2\n\nName;A;B\n';A (Real);A (Imag.);B (Real);B (Imag.)\n';{UNITS}\n"


def text(columns, sign, comma=False, form="%.9e"):
    lines = [sign.join(form % x for x in row) for row in np.column_stack(columns)]
    return "\n".join(lines).replace(".", "," if comma else ".") + "\n"


PARTS = [FREQ, VALUES[0].real, VALUES[0].imag]
POLAR = [FREQ, np.abs(VALUES[0]), np.rad2deg(np.angle(VALUES[0]))]
LEVELS = [FREQ, 20 * np.log10(np.abs(VALUES[0])), np.angle(VALUES[0])]
BOTH = [FREQ, VALUES[0].real, VALUES[0].imag, VALUES[1].real, VALUES[1].imag]


@pytest.mark.parametrize(
    ("name", "content", "form", "count"),
    [
        ("a.txt", text(PARTS, "\t"), None, 1),
        ("a.txt", text(PARTS, "  "), None, 1),
        ("a.dat", text(PARTS, "\t", comma=True), None, 1),
        ("a.asc", text(PARTS, " ", comma=True), None, 1),
        ("a.csv", "Frequency (Hz),Real (m/N),Imaginary (m/N)\n" + text(PARTS, ","), "receptance", 1),
        ("a.csv", HEAD + text(BOTH, ";", comma=True), "accelerance", 2),
        ("a.txt", "Frequency[Hz]\tMagnitude\tPhase[deg]\n" + text(POLAR, "\t"), None, 1),
        ("a.txt", text(POLAR, "\t"), None, 1),
        ("a.csv", "f,Magnitude (dB),Phase (rad)\n" + text(LEVELS, ","), None, 1),
        ("a.txt", "Frequency\t Real\t Imaginary\n\nUnits:\nHz\t(m/s²)(N)\t\n" + text(PARTS, "\t"), "accelerance", 1),
        ("a.csv", "freq (kHz),real,imag\n" + text([1e-3 * FREQ, *PARTS[1:]], ","), None, 1),
    ],
)
def test_tables_of_other_programs(tmp_path, name, content, form, count):
    path = tmp_path / name
    path.write_text(content, encoding="cp1252")
    read = read_responses([path], Reading(form or "mobility"))
    factor = {"receptance": 2j * np.pi * FREQ, "accelerance": 1 / (2j * np.pi * FREQ)}.get(form, 1.0)
    assert read.freq == pytest.approx(FREQ, rel=1e-8)
    assert np.allclose(read.mobility, factor * VALUES[:count], rtol=1e-7)
    if form:
        assert np.allclose(read_responses([path], Reading()).mobility, read.mobility)
    assert bool(read.remarks) == (not content[:1].isalpha())


@pytest.mark.parametrize("kind", ["npy", "mat", "real", "rounded"])
def test_a_matrix_may_begin_with_its_frequencies(tmp_path, kind):
    """One matrix alone, complex, or real with both parts; the remark names the unit that was taken."""
    from scipy.io import savemat

    whole = np.stack([FREQ, *VALUES], axis=1)
    if kind == "real":
        whole = np.stack(PARTS, axis=1)
    path = tmp_path / ("a.mat" if kind == "mat" else "a.npy")
    if kind == "mat":
        savemat(path, {"FRF": whole})
    else:
        np.save(path, whole.astype(np.complex64) if kind == "rounded" else whole)
    read = read_responses([path], Reading("mobility"))
    assert np.array_equal(read.freq, FREQ)
    assert np.allclose(read.mobility, VALUES[: len(read.pairs)], rtol=1e-6)
    assert len(read.pairs) == (1 if kind == "real" else 2)
    assert "taken for frequencies in Hz; divide it by 2 pi" in read.remarks[0]


COMPLEX = [f"{x.real:.9e}{x.imag:+.9e}" for x in VALUES[0]]
HALF = slice(None, None, -1)
WHOLE = np.concatenate([VALUES[0], VALUES[0][HALF].conj()])


def lines(*columns, head="", sign=","):
    return head + "\n".join(sign.join(map(str, row)) for row in zip(*columns, strict=True)) + "\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (lines(FREQ, [f"{x}i" for x in COMPLEX], head="f,H\n"), "no columns are named"),
        (lines(FREQ, [f"({x}j)" for x in COMPLEX], sign="\t"), "no columns are named"),
        (lines(FREQ, VALUES[0].imag, VALUES[0].real, head="f,imag,real\n"), None),
        (lines(VALUES[0].real, VALUES[0].imag, FREQ, head="real,imag,freq (Hz)\n"), None),
        (lines(FREQ[HALF], VALUES[0].real[HALF], VALUES[0].imag[HALF], head="f,real,imag\n"), None),
        (lines(FREQ, LEVELS[1] - 99.0, POLAR[2], head="f,mag,phase\n"), "magnitudes below 0 were taken for dB"),
        (lines(FREQ, LEVELS[1] - 99.0, POLAR[2]), "taken for magnitude and phase in degrees"),
        (lines(FREQ, POLAR[1], LEVELS[2], head="f,mag,phase\n"), "phases that stay within pi were taken for radians"),
        (lines(*PARTS, head="f,real,imag\n") + "end\n" + lines(*(x[:20] for x in PARTS)), "20 lines of the shorter"),
        (lines(*([f'"{x}"' for x in row] for row in PARTS), head='"f","real","imag"\n'), None),
        (lines(*([f'"{x}"'.replace(".", ",") for x in row] for row in PARTS), head='"f","real","imag"\n'), None),
        (lines(*POLAR, head="f,Amplitude,Phase (Grad)\n"), None),
        (lines(*POLAR, head="f,Ampiezza,Fase (gradi)\n"), None),
        (lines(*POLAR, head="Frequenz,Betrag,Phase [Grad]\n"), None),
        (lines(FREQ, LEVELS[1] + 120, POLAR[2], head="f,Magnitude (dB re 1e-6),Phase (deg)\n"), None),
        (lines(FREQ, LEVELS[1] + 120, POLAR[2], head="f,Magnitude (dB ref 10^-6),Phase (deg)\n"), None),
    ],
)
def test_numbers_written_in_other_ways_are_the_same_response(tmp_path, content, said):
    """Complex numbers as text, columns in another order, falling frequencies, dB and radians that no head names."""
    (tmp_path / "a.csv").write_text(content)
    read = read_responses([tmp_path / "a.csv"], Reading("mobility"))
    factor = 10 ** (-99 / 20) if "dB" in (said or "") or "degrees" in (said or "") else 1.0
    assert np.allclose(read.mobility, factor * VALUES[:1], rtol=1e-7)
    assert any(said in line for line in read.remarks) if said else not read.remarks


def test_empty_cells_are_bins_without_numbers_and_end_no_table(tmp_path):
    gaps = [["" if 10 <= i < 15 else repr(float(x)) for i, x in enumerate(column)] for column in PARTS[1:]]
    (tmp_path / "a.csv").write_text(lines(FREQ, *gaps, head="f,real,imag\n"))
    read = read_responses([tmp_path / "a.csv"], Reading("mobility"))
    assert np.array_equal(read.freq, FREQ)
    assert np.array_equal(np.flatnonzero(np.isnan(read.mobility[0])), np.arange(10, 15))


@pytest.mark.parametrize(
    ("step", "first", "is_time"),
    [(0.9e-3, 0.0, True), (1.2e-3, 0.0, False), (0.9e-3, 19.8, True), (0.9e-3, 20.0, False), (-0.9e-3, 1.0, False)],
)
def test_a_first_column_without_a_name_is_time_in_steps_of_a_millisecond_up_to_20_s(tmp_path, step, first, is_time):
    columns = [first + step * np.arange(100), np.sin(FREQ), np.cos(FREQ)]
    (tmp_path / "a.txt").write_text(text(columns, "\t"))
    record = record_of_text(tmp_path / "a.txt")
    assert (record is not None) == is_time
    if record is not None:
        assert record[3] == [1.0, 1.0]
        for read, wanted in zip(record, [*columns[:2], [columns[2]]], strict=False):
            assert np.allclose(read, wanted, atol=1e-8)


@pytest.mark.parametrize(
    ("size", "names", "level", "told"),
    [
        ([0.5, 0.1], ("mag", "deg"), False, []),
        ([0.5, 0.0], ("mag", "rad"), False, []),
        ([0.5, -0.1], ("mag", "deg"), True, ["magnitudes below 0 were taken for dB"]),
        ([0.5, -0.1], ("mag db", "deg"), True, []),
        ([0.5, 0.1], ("mag", "phase"), False, ["phases that stay within pi were taken for radians"]),
    ],
)
def test_magnitudes_and_phases_are_read_by_their_names_and_values(size, names, level, told):
    said = []
    phase = np.array([3.0, -2.0])
    found = _polar(np.array(size), phase, *names, said)
    turned = np.deg2rad(phase) if names[1] == "deg" else phase
    assert found == pytest.approx((10 ** (np.array(size) / 20) if level else np.array(size)) * np.exp(1j * turned))
    assert said == told


def test_rows_at_0_hz_are_no_frequencies_that_fall(tmp_path):
    """Two before the first frequency, and one that fills the table up."""
    padded = [np.concatenate([[0.0, 0.0], column, [0.0]]) for column in PARTS]
    (tmp_path / "a.csv").write_text(lines(*padded, head="f,real,imag\n"))
    read = read_responses([tmp_path / "a.csv"], Reading("mobility"))
    assert np.array_equal(read.freq[read.freq > 0], FREQ)
    assert np.allclose(read.mobility[0, read.freq > 0], VALUES[0], rtol=1e-7)


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (lines(np.sin(FREQ), VALUES[0].imag, FREQ), "frequencies do not rise; the first column has to hold them"),
        (lines(2 * np.pi * FREQ, *PARTS[1:], head="w,real,imag\n"), "may be in rad/s"),
        (
            lines(np.arange(200.0), WHOLE.real, WHOLE.imag, head="f,real,imag\n"),
            "two-sided: from bin 101 on they are the conjugate",
        ),
        (lines(FREQ, POLAR[1], LEVELS[2], head="freq_Hz,a:a_mag,a:a_phase\n"), "stays within pi: radians"),
        (lines(FREQ, LEVELS[1] - 99, POLAR[2], head="freq_Hz,a:a_mag,a:a_phase\n"), "holds a value below 0: dB"),
        (lines([f"{10 * x:,.1f}" for x in FREQ], *PARTS[1:], head="f;real;imag\n", sign=";"), "line 82: is '1,000.0;"),
        (lines(*PARTS, head="f,real,imag\n") + "1_20,1,1\n" + lines(*PARTS), "line 102: is '1_20,1,1', beside"),
        (lines(["95.0", *FREQ], ["n/a", *PARTS[1]], ["1.0", *PARTS[2]], head="f,real,imag\n"), "line 2: is '95.0,n/a"),
        (lines(*PARTS, head="f,osa tosi,osa toinen\n"), r"are not clear \(osa tosi, osa toinen\)"),
    ],
)
def test_columns_in_another_place_or_unit_are_refused_in_one_line(tmp_path, content, reported):
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(TonewoodError, match=reported) as fault:
        read_responses([tmp_path / "a.csv"], Reading("mobility"))
    assert "\n" not in str(fault.value)


def hit(n=4000, fs=8000.0):
    """Time, force, and acceleration of one mass on a spring and a dashpot, (n,) each, by its impulse response."""
    t = np.arange(n) / fs
    force = 40 * np.exp(-0.5 * ((t - 0.004) / 3e-4) ** 2)
    w, zeta = 2 * np.pi * 200.0, 1 / 60
    turned = w * np.sqrt(1 - zeta**2)
    velocity = np.exp(-zeta * w * t) * (np.cos(turned * t) - zeta * w / turned * np.sin(turned * t)) / 0.2
    velocity[0] /= 2  # the mean of both sides of its step
    return t, force, np.convolve(force, velocity)[:n] / fs


@pytest.mark.parametrize(
    ("head", "times", "needed"),
    [
        ("Time (s),Force (N),Acc (m/s^2)", 1.0, None), ("Time (ms),Force [N],Acc", 1e-3, None),
        ("Zeit [µs],Kraft,Beschleunigung", 1e-6, None), ("Time (s),Force (N),Acc (g)", 1.0, "1,9.80665"),
        ("Time,Force,Velocity\ns,mN,mm/s", 1.0, "0.001,0.001"), ("Time (s),Force (kN),Acc (V)", 1.0, "1000,?"),
    ],
)  # fmt: skip
def test_units_of_records_over_time(tmp_path, head, times, needed):
    """Times in ms and microseconds are read so; for other units the sensitivities are asked for."""
    t, force, velocity = hit(n=200)
    (tmp_path / "a.csv").write_text(head + "\n" + text([t / times, force, velocity], ","))
    reading = Reading("mobility", points=("p",), references=(("p", ""),))
    if needed is not None:
        with pytest.raises(TonewoodError) as fault:
            read_responses([tmp_path / "a.csv"], reading)
        assert str(fault.value).endswith(f"not in SI units: --sensitivity {needed}")
        reading = replace(reading, sensitivity=(2.0, 3.0))
    read = read_responses([tmp_path / "a.csv"], reading)
    assert read.freq[1] == pytest.approx(1 / (t[1] * 200), rel=1e-6)


def test_a_hit_that_holds_no_finite_number_is_refused(tmp_path):
    t, force, velocity = hit(n=200)
    lines_of = text([t, force, velocity], ",").splitlines()
    lines_of[50] = lines_of[50].rpartition(",")[0] + ","
    (tmp_path / "a.csv").write_text("\n".join(["Time (s),Force (N),Velocity (m/s)", *lines_of]) + "\n")
    with pytest.raises(TonewoodError, match="holds a sample that is not a finite number"):
        read_responses([tmp_path / "a.csv"], Reading("mobility", points=("p",), references=(("p", ""),)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "head", "form", "swapped"),
    [
        ("a.txt", "", "%.9e", False),
        ("a.csv", "Time [s];Accel;Hammer [N]\n;;\n", "%.9e", True),
        ("a.dat", "t (s)\tv\tforce\n", "%.9e", True),
        ("rounded.txt", "", "%.2e", False),
    ],
)
def test_a_hit_of_any_program_is_a_text_whose_first_column_is_time(tmp_path, name, head, form, swapped):
    """One mode of 200 Hz, Q 30 and 0.2 kg; the force is the column called so, or the first; times of three digits."""
    t, force, velocity = hit()
    columns = [t, velocity, force] if swapped else [t, force, velocity]
    sign = ";" if ";" in head else "\t"
    rows = text(columns, sign)
    if form != "%.9e":  # times with three digits alone
        rows = "\n".join(
            form % at + "\t" + line.split("\t", 1)[1] for at, line in zip(t, rows.splitlines(), strict=True)
        )
    (tmp_path / name).write_text(head + rows)
    fit = fit_responses(
        read_responses([tmp_path / name], Reading("mobility", points=("a",), references=(("a", ""),))),
        band=(20.0, 1000.0),
    )
    row = next(row for row in fit.rows if row["measured"])
    assert fit.body is not None
    assert row["freq_Hz"] == pytest.approx(200.0, rel=1e-3)
    assert row["Q"] == pytest.approx(30.0, rel=0.02)
    assert row["mass_kg"] == pytest.approx(0.2, rel=0.02)
    assert any("one hit at a" in line for line in fit.warnings)


def test_the_driving_point_may_stand_in_another_file(tmp_path):
    for i, row in enumerate(VALUES):
        (tmp_path / f"point {i}.txt").write_text(text([FREQ, row.real, row.imag], "\t"))
    paths = [tmp_path / "point 0.txt", tmp_path / "point 1.txt"]
    read = read_responses(paths, Reading("mobility", references=(("point_1", ""),)))
    assert read.pairs == (("point_0", "point_1"), ("point_1", "point_1"))
    with pytest.raises(TonewoodError, match="there is no point 'b'; there are point_0, point_1"):
        read_responses(paths, Reading("mobility", references=(("b", ""),)))


@pytest.mark.parametrize(
    ("name", "content", "reported"),
    [
        ("a.txt", text([FREQ, np.abs(VALUES[0])], "\t"), "magnitudes without phase"),
        ("a.csv", "f,Magnitude\n" + text(POLAR[:2], ","), "magnitudes without phase"),
        ("a.csv", "f,Magnitude,Magnitude\n" + text([*POLAR[:2], POLAR[1]], ","), "magnitudes without phase"),
        (
            "a.csv",
            "f,Magnitude,Magnitude,Phase\n" + text([*POLAR[:2], *POLAR[1:]], ","),
            "3 columns after the first are not clear",
        ),
        ("a.csv", "freq_Hz,a:a_re,a:a_im\n" + text([*PARTS[:2], 0 * FREQ], ","), "magnitudes without phase"),
        ("a.csv", "omega (rad/s),real,imag\n" + text(PARTS, ","), "may be in rad/s: divide it by 2 pi"),
        (
            "a.csv",
            "Time (s),force,acc\n" + text(PARTS, ","),
            "holds a record over time, of 99 s, of a force and 1 resp",
        ),
        ("a.txt", text([2e-5 * np.arange(100), *PARTS[1:]], "\t"), "of a force and 1 responses: name"),
        ("a.txt", text([*PARTS, FREQ], "\t"), "3 columns after the first are not clear"),
        ("a.txt", "no numbers\n", "holds no table of numbers"),
        ("a.txt", "\0", "is no text"),
        ("a.xlsx", "", "export frequency, real and imaginary parts as text"),
    ],
)
def test_texts_that_are_no_responses_are_refused_in_one_line(tmp_path, name, content, reported):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(TonewoodError, match=reported) as fault:
        read_responses([path], Reading("mobility"))
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("kind", ["steps", "two columns"])
def test_arrays_with_a_step_in_place_of_frequencies(tmp_path, kind):
    """As Testlab and CutPro save them."""
    from scipy.io import savemat

    if kind == "steps":
        axis = {"start_value": 20, "increment": 1, "number_of_values": FREQ.size}
        savemat(tmp_path / "a.mat", {"FRF": {"x_values": axis, "y_values": {"values": VALUES[0]}}})
    else:
        both = np.stack([VALUES[0].real, VALUES[0].imag], axis=1)
        savemat(tmp_path / "a.mat", {"H": both, "df": 1.0, "f_start": 20, "f_end": 119.0})
    read = read_responses([tmp_path / "a.mat"], Reading("mobility"))
    assert np.array_equal(read.freq, FREQ)
    assert np.allclose(read.mobility, VALUES[:1])
    assert bool(read.remarks) == (kind == "two columns")


@pytest.mark.parametrize(
    ("arrays", "reported"),
    [
        ({"w": FREQ, "H": VALUES[0]}, "w may be in rad/s: save freq_Hz = w / (2 pi)"),
        ({"omega": FREQ, "H": VALUES[0]}, "omega may be in rad/s"),
        ({"t": FREQ, "x": VALUES[0].real}, "records over time are read as text, one hit a file"),
        ({"f": np.ones(100), "x": np.ones(100), "dt": np.array(0.1)}, "records over time are read as text"),
        ({"freq": FREQ, "H": np.abs(VALUES[0])}, "H is real: magnitudes without phase"),
    ],
)
def test_arrays_that_are_no_responses_are_refused_in_one_line(tmp_path, arrays, reported):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(TonewoodError) as fault:
        read_responses([tmp_path / "a.npz"], Reading("mobility"))
    assert reported in str(fault.value)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("unit", "form", "scale"),
    [
        ("mm/s^2/N", "accelerance", "0.001"), ("g/N", "accelerance", "9.80665"), ("µm/s/N", "mobility", "1e-06"),
        ("mm / N", "receptance", "0.001"), ("m/s/N", "mobility", None), ("m/N", "receptance", None),
    ],
)  # fmt: skip
def test_units_that_are_not_si_are_named_with_their_factor(tmp_path, unit, form, scale):
    (tmp_path / "a.csv").write_text(lines(*PARTS, head=f"Frequency (Hz),Real ({unit}),Imag ({unit})\n"))
    remarks = read_responses([tmp_path / "a.csv"], Reading()).remarks
    assert read_responses([tmp_path / "a.csv"], Reading(form)).remarks == remarks
    assert (f"--scale {scale} makes it SI" in remarks[0]) if scale else not remarks


def test_frequencies_that_are_named_as_khz_or_rad_are_no_hz(tmp_path):
    np.savez(tmp_path / "a.npz", freq_kHz=1e-3 * FREQ, H=VALUES[0])
    assert read_responses([tmp_path / "a.npz"], Reading("mobility")).freq == pytest.approx(FREQ, rel=1e-12)
    np.savez(tmp_path / "b.npz", freq_rad=2 * np.pi * FREQ, H=VALUES[0])
    with pytest.raises(TonewoodError, match="may be in rad/s"):
        read_responses([tmp_path / "b.npz"], Reading("mobility"))


@pytest.mark.parametrize("names", ["real,real,imag", "magnitude,magnitude,phase", "imag,real,real"])
def test_columns_without_their_partner_are_not_clear(tmp_path, names):
    path = tmp_path / "a.csv"
    path.write_text(f"f,{names}\n" + text([FREQ, *VALUES.real, VALUES[0].imag], ","))
    with pytest.raises(TonewoodError, match="its 3 columns after the first are not clear"):
        read_responses([path], Reading("mobility"))
