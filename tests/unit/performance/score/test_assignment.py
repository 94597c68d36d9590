"""Notes to strings: everything accounted for, one note per string at a time, and the least cost there is."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tonewood.errors import ScoreError
from tonewood.instrument.scales import Scale, Tuning
from tonewood.performance.score import fingering
from tonewood.performance.score.assignment import Assignment, PlayableString, StringChooser, assign
from tonewood.performance.score.fingering import Chord, FingeringCosts, Option, finger
from tonewood.performance.score.note import Note

GUITAR = [
    PlayableString.fretted(name, pitch, 19)
    for name, pitch in {"E2": 40, "A2": 45, "D3": 50, "G3": 55, "B3": 59, "E4": 64}.items()
]
HARP = [PlayableString.fretted(f"s{k}", k) for k in (48, 50, 52, 53, 55)]


def places(assignment: Assignment) -> list[tuple[str, float]]:
    return [(a.string, a.stop) for a in assignment.notes]


def reasons(assignment: Assignment) -> list[str]:
    return [d.reason for d in assignment.dropped]


class TestWhatANoteAsksFor:
    def test_a_pitch_goes_to_its_lowest_place(self):
        assert places(assign([Note(0.0, note=40), Note(1.0, note=64)], GUITAR)) == [("E2", 0), ("E4", 0)]

    @pytest.mark.parametrize(
        ("asked", "place"),
        [
            ({"string": "A2", "stop": 3}, ("A2", 3)),
            ({"string": "A2"}, ("A2", 0)),
            ({"string": "A2", "note": 50}, ("A2", 5)),
            ({"string": "A2", "note": 50, "stop": 5}, ("A2", 5)),
            ({"note": 64, "stop": 9}, ("G3", 9)),
            ({"freq": 110.0}, ("A2", 0)),
            ({"string": "E2", "freq": 110.0}, ("E2", 5)),
        ],
    )
    def test_string_and_stop_are_honoured(self, asked, place):
        assert places(assign([Note(0.0, **asked)], GUITAR)) == [place]

    @pytest.mark.parametrize(
        ("asked", "reason"),
        [
            ({}, "neither a pitch nor a string"),
            ({"stop": 3}, "neither a pitch nor a string"),
            ({"note": 39}, "no string plays D#2 (the strings reach from E2 to B5)"),
            ({"note": 84}, "no string plays C6"),
            ({"string": "C1"}, "there is no string 'C1' (strings: E2, A2"),
            ({"string": "E2", "stop": 20}, "string E2 has no stop 20 (it has E2 to B3)"),
            ({"string": "E2", "stop": 2.5}, "string E2 has no stop 2.5"),
            ({"string": "E2", "note": 80}, "string E2 does not play G#5"),
            ({"string": "E2", "stop": 3, "note": 60}, "stop 3 of string E2 plays G2, not C4"),
            ({"note": 41, "stop": 2}, "no string plays F2 at stop 2"),
        ],
    )
    def test_the_impossible_is_dropped_with_its_reason(self, asked, reason):
        result = assign([Note(2.0, channel=3, **asked)], GUITAR)
        assert result.notes == ()
        (dropped,) = result.dropped
        assert dropped.reason.startswith(reason)
        assert (dropped.time, dropped.note, dropped.channel) == (2.0, asked.get("note"), 3)

    @pytest.mark.parametrize(
        ("pitch", "stop", "cents"), [(45.3, 0, 30), (44.6, 0, -40), (46.5, 1, 50), (63.7, 19, -30)]
    )
    def test_a_pitch_between_stops_is_the_nearest_stop_and_the_cents_to_it(self, pitch, stop, cents):
        (assigned,) = assign([Note(0.0, note=pitch, string="A2" if stop < 2 else None)], GUITAR[1:2]).notes
        assert (assigned.stop, assigned.cents) == (stop, pytest.approx(cents))

    def test_cents_are_those_of_the_tuning(self):
        """Half way between two keys of a scale with a step of 80 cents lie 40 cents."""
        tuning = Tuning(Scale("narrow", (80.0, 1200.0)))
        string = [PlayableString.fretted("s", 60, 2)]
        (assigned,) = assign([Note(0.0, note=60.5)], string, tuning=tuning).notes
        assert (assigned.stop, assigned.cents) == (0, pytest.approx(40.0))
        (by_freq,) = assign([Note(0.0, freq=tuning.freq(61))], string, tuning=tuning).notes
        assert (by_freq.stop, by_freq.cents) == (1, pytest.approx(0.0, abs=1e-9))

    def test_a_string_without_frets_stops_anywhere(self):
        violin = [PlayableString("G3", (55.0, 79.0), continuous=True)]
        result = assign([Note(0.0, note=60.37), Note(1.0, note=54.6), Note(2.0, note=79.6)], violin)
        assert [(a.stop, a.cents) for a in result.notes] == [(pytest.approx(5.37), 0.0), (0.0, pytest.approx(-40.0))]
        assert reasons(result) == ["no string plays G#5-40 (the strings reach from G3 to G5)"]

    def test_a_channel_per_string(self):
        notes = [Note(0.0, note=50, channel=0), Note(0.0, note=50, channel=1), Note(0.0, note=50, channel=2)]
        assert places(assign(notes, GUITAR, channel_per_string=True)) == [("E2", 10), ("A2", 5), ("D3", 0)]
        wrong = [Note(0.0, note=39, channel=0), Note(0.0, note=50, channel=6), Note(0.0, note=50)]
        assert [r[:30] for r in reasons(assign(wrong, GUITAR, channel_per_string=True))] == [
            "string E2 does not play D#2 (i",
            "channel 7, where channels 1 to",
            "no channel, where channels 1 t",
        ]

    @pytest.mark.parametrize("strings", [[], [HARP[0], HARP[0]]])
    def test_strings_must_be_there_and_have_their_own_names(self, strings):
        with pytest.raises(ScoreError, match="strings"):
            assign([], strings)

    def test_stops_must_rise(self):
        with pytest.raises(ScoreError, match="must rise"):
            PlayableString("s", (60, 59))


class TestMoments:
    def test_open_chord_of_six(self):
        chord = [Note(0.0, note=n, channel=0) for n in (40, 47, 52, 56, 59, 64)]  # E major, as everybody plays it
        assert places(assign(chord, GUITAR)) == [("E2", 0), ("A2", 2), ("D3", 2), ("G3", 1), ("B3", 0), ("E4", 0)]

    def test_a_wide_chord_is_played_however_far_it_stretches(self):
        chord = [Note(0.0, note=n, channel=0) for n in (41, 83)]
        assert places(assign(chord, GUITAR)) == [("E2", 1), ("E4", 19)]

    def test_notes_too_many_are_dropped_the_quietest_first(self):
        chord = [Note(0.0, note=65, velocity_midi=v, channel=0) for v in (50, 90, 80, 70, 60, 40)]
        result = assign(chord, GUITAR)
        assert sorted(a.note.velocity_midi for a in result.notes) == [60, 70, 80, 90]
        assert [d.reason for d in result.dropped] == [
            "its pitch is played at its moment already, and no other string is free for it"
        ] * 2

    def test_a_cluster_of_128_keeps_six_with_the_outer_voices(self):
        result = assign([Note(0.0, note=n, channel=0) for n in range(128)], GUITAR)
        pitches = sorted(a.note.note for a in result.notes)
        assert (len(pitches), pitches[0], pitches[-1]) == (6, 40, 83)
        assert len(result.dropped) == 122

    def test_notes_of_one_string_close_together_follow_one_another(self):
        """Ten milliseconds apart, all below the second string: nothing is lost."""
        result = assign([Note(0.01 * i, 0.02, note=40 + i, channel=0) for i in range(5)], GUITAR)
        assert [a.string for a in result.notes] == ["E2"] * 5
        assert [a.end for a in result.notes] == pytest.approx([0.01, 0.02, 0.03, 0.04, 0.06])
        assert (result.dropped, result.n_cut) == ((), 4)

    def test_a_strum_is_one_chord(self):
        strum = [Note(0.006 * i, 1.0, note=n, channel=0) for i, n in enumerate((43, 47, 50, 55, 59, 67))]
        assert len({a.string for a in assign(strum, GUITAR).notes}) == 6

    @pytest.mark.parametrize(("apart", "strings"), [(0.02, ["G3", "B3"]), (0.04, ["B3", "B3"])])
    def test_a_chord_is_what_begins_within_30_ms(self, apart, strings):
        """Two short notes of one string: together they need two, one after the other they do not."""
        notes = [Note(0.0, 0.01, note=59, channel=0), Note(apart, 0.01, note=60, channel=0)]
        assert [a.string for a in assign(notes, GUITAR).notes] == strings

    def test_voices_that_meet_share_a_pluck(self):
        notes = [
            Note(0.0, 1.0, note=60, velocity_midi=50, channel=0),
            Note(0.0, 0.5, note=60, velocity_midi=90, channel=1),
        ]
        result = assign(notes, GUITAR)
        assert result.notes[0].note == replace(notes[1], duration=1.0)
        assert result.doubled == (notes[0],)

    @pytest.mark.parametrize("change", [{"channel": 0}, {"time": 0.002}, {"string": "G3"}, {"channel": None}])
    def test_one_voice_or_a_named_string_or_another_moment_does_not_share(self, change):
        second = replace(Note(0.0, 1.0, note=60, channel=1), **change)
        result = assign([Note(0.0, 1.0, note=60, channel=0), second], GUITAR)
        assert (len(result.notes), result.doubled) == (2, ())

    def test_the_same_pitch_again_stays_on_its_string_and_counts_as_no_cut(self):
        result = assign([Note(0.5 * i, 1.0, note=45, channel=0) for i in range(4)], GUITAR)
        assert places(result) == [("A2", 0)] * 4
        assert [a.end for a in result.notes] == [0.5, 1.0, 1.5, 2.5]
        assert (result.n_cut, result.cost) == (0, 0.0)

    def test_a_ringing_note_is_spared_where_another_string_can_play(self):
        """D4 is nearest on B3; while C4 rings there, it moves to the G string."""
        alone = assign([Note(0.0, 4.0, note=60), Note(4.0, 1.0, note=62)], GUITAR)
        ringing = assign([Note(0.0, 4.0, note=60), Note(1.0, 1.0, note=62)], GUITAR)
        assert places(alone)[1][0] == "B3"
        assert ringing.notes[0].string != ringing.notes[1].string
        assert ringing.n_cut == 0

    def test_no_notes(self):
        assert assign([], GUITAR) == Assignment((), (), (), 0, 0.0)


@pytest.mark.parametrize(("stop", "leaves"), [(9, False), (10, True)])
def test_a_held_finger_is_left_behind_once(stop, leaves):
    """Held at stop 5 from 0 to 4 s; a hand that moves up for other strings reaches one stop below itself, no more."""
    held = Chord(0.0, (4.0,), (4.0,), ((Option(0, 5.0),),))
    above = [Chord(t, (t + 1,), (1.0,), ((Option(s, float(stop + t - 1)),),)) for s, t in ((1, 1), (2, 2))]
    _, cost = finger(
        [held, *above[: 2 if leaves else 1]],
        3,
        FingeringCosts(position=0.0, shift=0.0, stretch=0.0, cut=1.0),
    )
    assert cost == (0.75 if leaves else 0.0)


def test_cost_of_three_notes_by_hand():
    """Stops 5, 2 and 9: hand 1 to 2, stays, then to 6; the first note is cut at half its length by another stop."""
    chords = [
        Chord(0.0, (2.0,), (2.0,), ((Option(0, 5.0),),)),
        Chord(1.0, (2.0,), (1.0,), ((Option(0, 2.0),),)),
        Chord(2.0, (3.0,), (1.0,), ((Option(0, 9.0),),)),
    ]
    _, cost = finger(chords, 1, FingeringCosts(position=0.1, shift=1.0, stretch=1.0, cut=6.0))
    assert cost == pytest.approx(0.1 * 16 + (1 + 4) + 6 * 0.5)


def least_cost(chords: list[Chord], costs: FingeringCosts) -> float:
    """The cost by its definition, in plain loops over every way through the piece."""
    best = np.inf
    ways = [
        [way for way in itertools.product(*chord.options) if len({o.string for o in way}) == len(way)]
        for chord in chords
    ]
    for path in itertools.product(*ways):
        cost, hand = 0.0, 1.0
        ringing: dict[int, list] = {}  # string: stop, end, duration, whether a finger holds it
        for chord, way in zip(chords, path, strict=True):
            ringing = {s: note for s, note in ringing.items() if note[1] > chord.time + 0.001}
            stops = [stop for _, stop in way if stop > 0]
            cost += costs.position * sum(stops)
            before = hand
            if stops:
                cost += costs.stretch * max(0.0, max(stops) - min(stops) - 3) ** 2
                low, high = sorted((max(stops) - 3, min(stops)))
                hand = min(max(hand, low), high)
            cost += costs.shift * abs(hand - before)
            played = dict(way)
            for string, note in ringing.items():
                left = (note[1] - chord.time) / note[2]
                if string in played:
                    cost += costs.cut * left * (played[string] != note[0])
                elif note[3] and not hand - 1 <= note[0] <= hand + 4:
                    cost += costs.cut * left
                    note[3] = False
            for (string, stop), end, duration in zip(way, chord.ends, chord.durations, strict=True):
                ringing[string] = [stop, end, duration, stop > 0]
        best = min(best, cost)
    return best


@st.composite
def small_pieces(draw) -> tuple[list[Chord], int, FingeringCosts]:
    opens = draw(st.lists(st.integers(0, 12), min_size=2, max_size=4, unique=True))
    chords, time = [], 0.0
    for _ in range(draw(st.integers(1, 5))):
        notes = draw(st.lists(st.integers(0, 20), min_size=1, max_size=2, unique=True))
        options = [tuple(Option(s, float(n - o)) for s, o in enumerate(opens) if 0 <= n - o <= 12) for n in notes]
        durations = [draw(st.sampled_from([0.25, 1.0, 3.0])) for _ in notes]
        chord = Chord(time, tuple(time + d for d in durations), tuple(durations), tuple(options))
        if any(len({o.string for o in way}) == len(way) for way in itertools.product(*options)):
            chords.append(chord)
        time += draw(st.sampled_from([0.25, 0.5, 1.0]))
    weights = draw(st.lists(st.floats(0, 5), min_size=4, max_size=4))
    return chords, len(opens), FingeringCosts(*weights)


@settings(max_examples=80)
@given(small_pieces())
def test_nothing_is_cheaper(piece):
    chords, n_strings, costs = piece
    chosen, cost = finger(chords, n_strings, costs)
    assert cost == pytest.approx(least_cost(chords, costs) if chords else 0.0, rel=1e-9, abs=1e-9)
    for chord, options in zip(chords, chosen, strict=True):
        assert all(option in allowed for option, allowed in zip(options, chord.options, strict=True))
        assert len({o.string for o in options}) == len(options)


@given(st.integers(0, 2**32 - 1))
def test_a_beam_ten_times_wider_finds_nothing_much_better(seed):
    rng = np.random.default_rng(seed)
    pitch = 52 + np.cumsum(rng.integers(-4, 5, 40)) % 24
    notes = [Note(0.2 * i, float(rng.choice([0.2, 0.8])), note=int(p), channel=0) for i, p in enumerate(pitch)]
    narrow = assign(notes, GUITAR).cost
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fingering, "BEAM_WIDTH", 640)
        wide = assign(notes, GUITAR).cost
    assert wide <= narrow + 1e-9
    assert narrow <= 1.02 * wide + 1e-9


def test_a_chord_with_more_ways_than_are_kept_is_still_played():
    """Twelve strings in unison and twelve notes of which one fits a single string: no dead end."""
    options = [tuple(Option(s, float(n)) for s in range(12)) for n in range(11)] + [(Option(0, 5.0),)]
    chord = Chord(0.0, (1.0,) * 12, (1.0,) * 12, tuple(options))
    (chosen,), _ = finger([chord], 12, FingeringCosts())
    assert sorted(o.string for o in chosen) == list(range(12))
    assert chosen[11] == (0, 5.0)


random_notes = st.lists(
    st.builds(
        Note,
        time=st.floats(0, 3).map(lambda t: round(t, 2)),
        duration=st.floats(0, 2),
        note=st.one_of(st.integers(36, 88), st.floats(36, 88)),
        velocity_midi=st.integers(1, 127),
        string=st.sampled_from([None, None, None, "E2", "G3", "none"]),
        stop=st.sampled_from([None, None, None, 0, 5]),
        channel=st.sampled_from([None, 0, 1]),
    ),
    max_size=40,
)


@given(random_notes, st.booleans(), st.sampled_from(["guitar", "harp"]))
def test_every_note_is_accounted_for_and_a_string_holds_one(notes, channel_per_string, instrument):
    strings = {"guitar": GUITAR, "harp": HARP}[instrument]
    result = assign(notes, strings, channel_per_string=channel_per_string)
    assert len(result.notes) + len(result.doubled) + len(result.dropped) == len(notes)
    assert [a.note.time for a in result.notes] == sorted(a.note.time for a in result.notes)
    by_name = {s.name: s for s in strings}
    for name, string in by_name.items():
        held = [a for a in result.notes if a.string == name]
        for a, b in itertools.pairwise(held):
            assert a.note.time < b.note.time
            assert a.end <= b.note.time
        for a in held:
            assert a.note.time <= a.end <= a.note.time + a.note.duration
            assert a.note.note == pytest.approx(string.pitches[int(a.stop)] + a.cents / 100)
            assert abs(a.cents) <= 50.001
            assert a.note.string in (None, name)
            assert a.note.stop in (None, a.stop)


def melody(seed: int) -> list[Note]:
    rng = np.random.default_rng(seed)
    return [Note(0.25 * (i // 2), 0.5, note=int(rng.integers(45, 76)), channel=0) for i in range(24)]


@given(st.integers(0, 1000), st.integers(-12, 12), st.floats(0.5, 8), st.floats(0, 100))
def test_transposed_instrument_time_stretched_and_shifted(seed, interval, stretch, shift):
    """Strings and notes transposed together, other tempo, later begin: the same hand does it all."""
    notes = melody(seed)
    strings = [PlayableString(s.name, tuple(p + interval for p in s.pitches)) for s in GUITAR]
    moved = [
        replace(n, note=n.note + interval, time=n.time * stretch + shift, duration=n.duration * stretch) for n in notes
    ]
    before, after = assign(notes, GUITAR), assign(moved, strings)
    assert after.cost == pytest.approx(before.cost, rel=1e-6)
    assert len(after.dropped) == len(before.dropped)


@given(st.integers(0, 1000), st.permutations(GUITAR))
def test_order_of_strings_does_not_matter(seed, strings):
    assert assign(melody(seed), strings).cost == pytest.approx(assign(melody(seed), GUITAR).cost, rel=1e-9)


@given(st.integers(0, 1000))
def test_a_string_more_never_costs_more(seed):
    """Where nothing is dropped, another string only adds ways to play."""
    notes = [n for n in melody(seed) if n.note >= 50][::2]
    fewer = assign(notes, GUITAR[1:])
    assert fewer.dropped == ()
    assert assign(notes, GUITAR).cost <= fewer.cost + 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_a_window_over_the_whole_piece_is_the_whole_piece(seed: int) -> None:
    """The first chord is played as if all were known, and alone as a piece of its own."""
    rng = np.random.default_rng(seed)
    strings = [PlayableString.fretted(f"s{i}", note, 15) for i, note in enumerate((40, 45, 50, 55, 59, 64))]
    keys = [float(k) for k in rng.integers(45, 75, 9)]
    notes = [Note(0.5 * (i // 2), 0.6, note=key) for i, key in enumerate(keys)]
    whole = assign(notes, strings).notes
    (*first,), dropped = StringChooser(strings).assign(notes[:2], {}, notes[2:])
    assert not dropped
    assert [(a.string, a.stop) for a in first] == [(a.string, a.stop) for a in whole[:2]]
    alone, _ = StringChooser(strings).assign(notes[:2], {})
    assert [(a.string, a.stop) for a in alone] == [(a.string, a.stop) for a in assign(notes[:2], strings).notes]
