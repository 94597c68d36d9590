"""Scales and mappings against printed tables and exact ratios, never against the code's own numbers."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonewood.errors import ScoreError
from tonewood.instrument.scales import (
    EQUAL_12,
    KeyMap,
    Scale,
    Tuning,
    note_name,
    note_number,
    read_kbm,
    read_scl,
    read_tuning,
)


@pytest.fixture
def write(tmp_path):
    def write(name: str, text: str | bytes):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def scl(*pitches: object, name: str = "a scale") -> str:
    return "\n".join(["! file.scl", "!", name, f" {len(pitches)}", "!", *(f" {p}" for p in pitches), ""])


def kbm(
    size=0, first=0, last=127, middle=60, reference=69, freq="440.0", octave=0, degrees: tuple[object, ...] = ()
) -> str:
    values = (size, first, last, middle, reference, freq, octave, *degrees)
    return "\n".join(f"! what comes next\n{v}" for v in values) + "\n"


def cents(ratio: Fraction | float) -> float:
    return 1200 * math.log2(ratio)


# Chain of fifths E flat to G sharp, as ratios within the octave
PYTHAGOREAN = ["2187/2048", "9/8", "32/27", "81/64", "4/3", "729/512"]
PYTHAGOREAN += ["3/2", "6561/4096", "27/16", "16/9", "243/128", "2/1"]
# Scala archive, meanquar.scl (P. Aaron 1523), rounded to cents
MEANTONE_PRINTED = [76, 193, 310, 386, 503, 579, 697, 773, 890, 1007, 1083, 1200]
# Scala archive, werck3.scl (A. Werckmeister 1681, no. III), rounded to cents
WERCKMEISTER_3_PRINTED = [90, 192, 294, 390, 498, 588, 696, 792, 888, 996, 1092, 1200]


class TestNames:
    @pytest.mark.parametrize(
        ("name", "number"),
        [
            *[("C4", 60), ("A4", 69), ("D2", 38), ("E2", 40), ("F#3", 54), ("Bb2", 46), ("C-1", 0), ("G9", 127)],
            *[("b3", 59), ("bb3", 58), ("B#3", 60), ("Cb4", 59), ("F##3", 55), ("E♭4", 63), ("G♯4", 68), (" A4 ", 69)],
        ],
    )
    def test_of_well_known_notes(self, name, number):
        assert note_number(name) == number

    @pytest.mark.parametrize("name", ["", "H2", "C", "4", "C#b4", "C###4", "C4.5", "Cis4", "C４", "C400"])
    def test_others_are_refused(self, name):
        with pytest.raises(ScoreError, match="is not a note"):
            note_number(name)

    @given(st.integers(-12, 127), st.booleans())
    def test_there_and_back(self, number, flats):
        assert note_number(note_name(number, flats=flats)) == number

    def test_of_fractions(self):
        assert [note_name(n) for n in (60.25, 59.75, 60.5, 60.004)] == ["C4+25", "C4-25", "C#4-50", "C4"]


class TestEqualTemperament:
    # Frequencies of the piano's keys as every table prints them
    @pytest.mark.parametrize(("name", "freq"), [("A0", 27.5), ("C4", 261.626), ("E2", 82.407), ("C8", 4186.01)])
    def test_printed_frequencies(self, name, freq):
        assert Tuning().freq(note_number(name)) == pytest.approx(freq, abs=0.005)

    def test_other_reference(self):
        assert Tuning(reference_freq=415.0).freq(57) == 207.5

    @given(st.floats(0, 127))
    def test_fractions_are_cents(self, note):
        assert Tuning().freq(note) == pytest.approx(440 * 2 ** ((note - 69) / 12), rel=1e-12)

    @pytest.mark.parametrize("freq", [0.0, -440.0, math.nan, math.inf])
    def test_impossible_reference(self, freq):
        with pytest.raises(ScoreError, match="reference frequency"):
            Tuning(reference_freq=freq)


class TestScl:
    def test_ratios_are_exact(self, write):
        scale = read_scl(write("p.scl", scl(*PYTHAGOREAN, name="Pythagorean")))
        assert scale.name == "Pythagorean"
        assert scale.cents == pytest.approx([cents(Fraction(r)) for r in PYTHAGOREAN], abs=1e-9)
        tuning = Tuning(scale)
        # A4 = 440: C4 lies 27/16 below it, E2 three fifths and an octave and more away: 440 · 3/4 / 4
        assert tuning.freq(60) == pytest.approx(440 * 16 / 27, rel=1e-12)
        assert tuning.freq(40) == pytest.approx(82.5, rel=1e-12)

    def test_meantone_in_cents(self, write):
        fifth = cents(5) / 4  # a quarter of the pure major seventeenth
        by_degree = [*sorted(fifth * k % 1200 for k in range(-3, 9))[1:], 1200.0]
        text = scl(*(f"{c:.6f}" for c in by_degree), name="1/4-comma")
        scale = read_scl(write("m.scl", text))
        assert [round(c) for c in scale.cents] == MEANTONE_PRINTED
        # its thirds are pure: C-E, A-C# against the reference
        tuning = Tuning(scale)
        assert tuning.freq(64) / tuning.freq(60) == pytest.approx(1.25, rel=1e-8)
        assert tuning.freq(73) == pytest.approx(550.0, rel=1e-8)

    def test_werckmeister_3_mixes_ratios_and_cents(self, write):
        mixed = ["256/243", "192.180", "32/27", "390.225", "4/3", "1024/729", "696.090"]
        mixed += ["128/81", "888.270", "16/9", "1092.180", "2"]
        scale = read_scl(write("w.scl", scl(*mixed)))
        assert [round(c) for c in scale.cents] == WERCKMEISTER_3_PRINTED
        comma = cents(Fraction(3**12, 2**19))
        tempered = {0, 7, 2, 11}  # C-G, G-D, D-A and B-F# are narrow by a quarter comma, the other fifths pure
        for low in range(12):
            fifth = scale.cents_at(low + 7) - scale.cents_at(low)
            assert fifth == pytest.approx(cents(1.5) - (comma / 4 if low in tempered else 0), abs=1e-3)

    def test_scale_without_octave(self, write):
        """Bohlen-Pierce: thirteen equal steps of the twelfth 3/1; one step is 146.304 cents."""
        text = scl(*(f"{cents(3) * i / 13:.5f} step {i}" for i in range(1, 13)), "3/1 the tritave")
        tuning = read_tuning(write("bp.scl", text), write("bp.kbm", kbm(reference=60, freq="220", middle=60)))
        assert tuning.freq(73) == pytest.approx(660.0)
        assert tuning.freq(47) == pytest.approx(220 / 3)
        assert cents(tuning.freq(61) / 220) == pytest.approx(146.304, abs=1e-3)

    def test_remarks_blanks_old_ends_of_line_and_encodings(self, write):
        raw = "! é\r\n\r\n 3 notes\r\n 100. C\r!\n -5.5\tcents\n2/1 Octave é\r\n\r\n".encode("latin-1")
        scale = read_scl(write("odd.scl", raw))
        assert scale == Scale("odd", (100.0, -5.5, 1200.0))
        assert read_scl(write("bom.scl", b"\xef\xbb\xbfname\n1\n2\n")).name == "name"

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("", "ends too early: number of notes"),
            ("name\n", "number of notes is ''"),
            ("name\nmany\n", "line 2: number of notes is 'many'"),
            ("name\n0\n", "line 2: number of notes is '0'"),
            ("name\n2\n3/2\n", "1 pitches where line 2 announces 2"),
            ("name\n1\n3/2\n2/1\n", "2 pitches where line 2 announces 1"),
            ("name\n1\n3/0\n", "line 3: '3/0' is not a pitch"),
            ("name\n1\n0/3\n", "line 3: '0/3'"),
            ("name\n1\n-3/2\n", "line 3: '-3/2'"),
            ("name\n1\nfifth\n", "line 3: 'fifth'"),
            ("name\n1\n1e3\n", "line 3: '1e3'"),
            ("name\n1\nnan\n", "line 3: 'nan'"),
            ("name\n1\n.\n", "line 3: '.'"),
            ("name\n1\n٣/٢\n", "line 3"),
            ("name\n1\n12000.1\n", "line 3: '12000.1': pitches within 12000 cents"),
            ("name\n1\n" + "9" * 399 + "\n", "pitches within"),
            ("name\n1\n" + "9" * 5000 + "/2\n", "is not a pitch"),
            ("name\n1\n-100.0\n", "must rise"),
            ("name\n1\n1/1\n", "must rise"),
        ],
    )
    def test_faults_name_file_line_and_value(self, write, text, reason):
        with pytest.raises(ScoreError) as caught:
            read_scl(write("bad.scl", text))
        assert reason in str(caught.value)
        assert "bad.scl: " in str(caught.value)

    def test_ten_octaves_between_neighbours_are_allowed(self, write):
        assert read_scl(write("wide.scl", scl("12000.0"))).cents == (12000.0,)

    def test_what_is_no_small_file_is_refused(self, tmp_path, write):
        for path in (tmp_path, tmp_path / "none.scl", write("big.scl", b" " * (2**20 + 1))):
            with pytest.raises(ScoreError):
                read_scl(path)


class TestKbm:
    def test_size_0_is_linear(self, write):
        steps = scl(*(f"{1200 * i / 31:.6f}" for i in range(1, 32)))
        tuning = read_tuning(
            write("31.scl", steps), write("k.kbm", kbm(middle=62, reference=62, freq="293.0", octave=5))
        )
        assert cents(tuning.freq(63) / 293) == pytest.approx(1200 / 31, abs=1e-5)
        assert tuning.freq(62 + 31) == pytest.approx(586.0)
        assert tuning.freq(62 - 31) == pytest.approx(146.5)

    def test_white_keys_only(self, write):
        """A seven-note scale on the white keys; black keys play nothing."""
        degrees = (0, "x", 1, "x", 2, 3, "x", 4, "x", 5, "X", 6)
        just = scl("9/8", "5/4", "4/3", "3/2", "5/3", "15/8", "2/1")
        tuning = read_tuning(write("j.scl", just), write("w.kbm", kbm(size=12, octave=7, degrees=degrees)))
        ratios = {60: "1", 62: "9/8", 64: "5/4", 65: "4/3", 67: "3/2", 69: "5/3", 71: "15/8", 72: "2", 48: "1/2"}
        for key, ratio in ratios.items():
            assert tuning.freq(key) == pytest.approx(float(264 * Fraction(ratio)), rel=1e-12)  # 440 · 3/5
        for silent in (61, 70, 70.5):
            with pytest.raises(ScoreError, match="plays nothing"):
                tuning.freq(silent)

    def test_pattern_may_be_shorter_than_its_size_and_repeat_at_another_degree(self, write):
        """Two of every three keys sound; the next three start a fifth (degree 7 of 12) higher."""
        tuning = read_tuning(None, write("s.kbm", kbm(size=3, reference=60, freq="100", octave=7, degrees=(0, 2))))
        assert cents(tuning.freq(61) / 100) == pytest.approx(200)
        assert cents(tuning.freq(63) / 100) == pytest.approx(700)
        assert cents(tuning.freq(57) / 100) == pytest.approx(-700)
        with pytest.raises(ScoreError, match=r"key 62 \(D4\)"):
            tuning.freq(62)

    def test_octave_degree_0_is_the_last_of_the_scale(self, write):
        pattern = kbm(size=2, reference=60, freq="100", octave=0, degrees=(0, 1))
        tuning = read_tuning(write("s.scl", scl("3/2", "3/1")), write("s.kbm", pattern))
        assert [tuning.freq(k) for k in (60, 61, 62, 63, 58)] == pytest.approx([100, 150, 300, 450, 100 / 3])

    def test_degrees_beyond_the_scale_go_on_through_its_octaves(self, write):
        pattern = kbm(size=2, reference=60, freq="100", octave=24, degrees=(0, 19))
        tuning = read_tuning(None, write("d.kbm", pattern))
        assert cents(tuning.freq(61) / 100) == pytest.approx(1900)
        assert cents(tuning.freq(62) / 100) == pytest.approx(2400)

    def test_keys_outside_the_range_keep_equal_temperament(self, write):
        tuning = read_tuning(None, write("r.kbm", kbm(first=60, last=72, freq="415.0")))
        assert tuning.freq(69) == pytest.approx(415.0)
        assert tuning.freq(57) == pytest.approx(220.0)
        assert tuning.freq(81) == pytest.approx(880.0)

    def test_reference_frequency_can_be_replaced(self, write):
        path = write("r.kbm", kbm(freq="415.0"))
        assert read_tuning(None, path).freq(69) == pytest.approx(415)
        assert read_tuning(None, path, reference_freq=392.0).freq(69) == pytest.approx(392)
        assert read_tuning(reference_freq=442.0).freq(69) == pytest.approx(442)

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("", "ends too early: size of the map"),
            (kbm(size=-1), "size of the map is '-1'"),
            (kbm(last=128), "last key is '128'"),
            (kbm(first=70, last=60), "first key 70 lies above"),
            (kbm(middle="C4"), "middle key is 'C4'"),
            (kbm(reference="69.5"), "reference key is '69.5'"),
            (kbm(freq="0"), "reference frequency '0'"),
            (kbm(freq="inf"), "reference frequency 'inf'"),
            (kbm(freq="A"), "reference frequency 'A'"),
            (kbm(octave="x"), "formal octave is 'x'"),
            (kbm(size=2, octave=12, degrees=(0, "y")), "degree (or x) is 'y'"),
            (kbm(size=2, octave=12, degrees=(0, 1, 2)), "3 keys are mapped"),
            (kbm(size=2, reference=61, octave=12, degrees=(0, "x")), "reference key 61 plays no degree"),
            ("12\n0\n127\n", "ends too early: middle key"),
        ],
    )
    def test_faults_name_file_and_value(self, write, text, reason):
        with pytest.raises(ScoreError) as caught:
            read_tuning(None, write("bad.kbm", text))
        assert reason in str(caught.value)
        assert "bad.kbm: " in str(caught.value)

    def test_line_numbers_count_comments(self, write):
        with pytest.raises(ScoreError, match=r"line 4: first key"):
            read_kbm(write("n.kbm", kbm(first=999)))


scales = st.lists(st.floats(1, 300), min_size=1, max_size=24).map(
    lambda steps: Scale("random", tuple(sum(steps[: i + 1]) for i in range(len(steps))))
)


@given(scales, st.floats(200, 600), st.floats(20, 110))
def test_note_of_a_frequency_is_the_inverse(scale, reference, note):
    tuning = Tuning(scale, reference_freq=reference)
    assert tuning.freq(tuning.note(tuning.freq(note))) == pytest.approx(tuning.freq(note), rel=1e-9)


@given(scales, st.integers(0, 127))
def test_one_period_up_is_the_formal_octave(scale, key):
    tuning = Tuning(scale, KeyMap(first=-300, last=300))
    period = tuning.cents_between(key, key + len(scale.cents))
    assert period == pytest.approx(scale.cents[-1], abs=1e-6)


@given(st.binary(max_size=200))
def test_random_files_end_well(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "random.txt"
    for raw in (data, b"name\n2\n" + data, b"12\n0\n127\n60\n69\n440\n12\n" + data):
        path.write_bytes(raw)
        for reader in (read_scl, read_kbm):
            try:
                reader(path)
            except ScoreError:
                continue


def test_notes_between_keys_that_fall_still_have_a_frequency():
    """A scale whose degrees do not rise: the note found sounds at the frequency, whichever it is."""
    tuning = Tuning(Scale("zigzag", (300.0, 100.0, 1200.0)))
    for freq in (300.0, 440.0, 700.0):
        assert tuning.freq(tuning.note(freq)) == pytest.approx(freq)
    assert EQUAL_12.cents_at(-1) == -100.0
