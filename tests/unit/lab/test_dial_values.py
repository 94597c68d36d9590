"""The user's dial: what is rendered and compared, and the words and tables made of it, on notes that are made up."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from tonewood.lab.accuracy import dial
from tonewood.lab.accuracy.dial import DialPoint, PartialErrors
from tonewood.lab.accuracy.strokes import Strokes, forces

#: what a thousandth more force changes: cents, decay, level
REGULAR, PITCH, DECAY, LEVEL = (0.2, 0.01, 0.2), (0.21, 0, 0), (0, 0.011, 0), (0, 0, 0.21)


def errors(*medians: float, worst: float = 2.0, waveform: float | None = None) -> PartialErrors:
    """Worst ones are twice the medians."""
    c, d, v = medians
    return PartialErrors(c, worst * c, d, worst * d, v, worst * v, 9, waveform)


class Note:
    """Strokes whose mode count tells the setting; errors tell which was compared with which."""

    asked: tuple[Any, ...] = ()
    chance: tuple[float, ...] = REGULAR

    def __init__(self) -> None:
        self.instrument, self.string = SimpleNamespace(spec=SimpleNamespace(name="lute")), "A"
        self.rendered: list[tuple[Any, ...]] = []

    def of(self, *asked: Any, **more: Any) -> Note:
        self.asked = (*asked, more)
        return self

    def strokes(self, setting: dict[str, Any], factors: tuple[float, ...] = (1.0,)) -> Strokes:
        self.rendered.append((*setting.values(), *([factors] if factors != (1.0,) else [])))
        return Strokes(tuple(factors), 7.0, len(self.rendered))  # type: ignore[arg-type]  # any sequence of sounds

    def errors(self, strokes: Strokes, truth: Strokes) -> PartialErrors:
        chance = self.chance if (strokes.sounds, truth.sounds) == ((1.001,), (1.0,)) else (0, 0, 0)
        return replace(errors(*chance), partials=10 * strokes.n_modes + truth.n_modes)

    def timed(self, settings: list[dict[str, Any]], repeats: int) -> list[float]:
        self.repeats, self.clocked = repeats, [tuple(s.values()) for s in settings]
        return [0.5 + i for i in range(len(settings))]


@pytest.fixture
def note(monkeypatch: pytest.MonkeyPatch) -> Note:
    made = Note()
    monkeypatch.setattr(dial, "NoteCase", made)
    return made


def told(points: list[DialPoint]) -> list[tuple[str, int, float, int]]:
    assert {(p.instrument, p.string) for p in points} == {("lute", "A")}
    return [(p.accuracy, p.errors.partials, p.seconds, p.strokes) for p in points]


def test_a_regular_note_is_held_against_reference_and_its_nudged_self(note: Note) -> None:
    """Changes of a fifth of a limit are still regular; reference is rendered first, and timed once."""
    assert told(dial.measure("lute", "A")) == [  # type: ignore[arg-type]  # passed on
        ("draft", 31, 0.5, 1), ("standard", 41, 1.5, 1), ("reference", 11, 7.0, 1), (dial.NUDGED, 21, 7.0, 1)
    ]  # fmt: skip
    assert note.asked == ("lute", "A", 4.0, {"fs": 48000})
    assert note.rendered == [("reference",), ("reference", (1.001,)), ("draft",), ("standard",)]
    assert (note.repeats, note.clocked) == (3, [("draft",), ("standard",)])


@pytest.mark.parametrize("chance", [PITCH, DECAY, LEVEL])
def test_strokes_of_a_sensitive_note_are_compared(note: Note, chance: tuple[float, ...]) -> None:
    note.chance = chance
    points = dial.measure("lute", "A")  # type: ignore[arg-type]  # passed on
    assert told(points) == [
        ("draft", 35, 0.5, 32), ("standard", 45, 1.5, 32), ("reference", 55, 7.0, 32), (dial.OTHERS, 55, 7.0, 16)
    ]  # fmt: skip
    assert note.rendered[2:] == [(name, forces(32)) for name in ("draft", "standard", "reference")]


def test_a_quick_note_is_short_and_not_nudged(note: Note) -> None:
    points = told(dial.measure("lute", "A", nudge=False))  # type: ignore[arg-type]  # passed on
    assert points == [("draft", 13, 7.0, 1), ("standard", 23, 7.0, 1), ("reference", 33, 7.0, 1)]
    assert note.asked == ("lute", "A", 1.5, {"fs": 48000})


@pytest.mark.parametrize(("quick", "duration"), [(True, 1.5), (False, 4.0)])
def test_effects_and_budgets_are_held_against_all(note: Note, quick: bool, duration: float) -> None:
    points = told(dial.budgets(quick=quick))
    budgets = ("auto, 0.05 cents, -120 dB", "auto, 0.5 cents, -80 dB", "auto, 5 cents, -40 dB")
    assert [p[0] for p in points] == ["all", *budgets, "none"]
    assert [p[1] for p in points] == [11, 21, 31, 41, 51]
    assert [p[2] for p in points] == ([7.0] * 5 if quick else [0.5, 1.5, 2.5, 3.5, 4.5])
    assert note.asked[1:] == ("G3", duration, {"force": 2.0, "fs": 48000})
    auto = [("auto", 0.05, -120.0), ("auto", 0.5, -80.0), ("auto", 5.0, -40.0)]
    assert note.rendered == [("all",), *auto, ("none",)]
    assert quick or note.repeats == 3


def test_every_shipped_instrument_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = {
        name: SimpleNamespace(distribution=by) for name, by in (("a", "tonewood"), ("b", "x"), ("c", "tonewood"))
    }
    monkeypatch.setattr(dial, "entries", lambda group: shipped)
    monkeypatch.setattr(dial.Instrument, "load", lambda name: SimpleNamespace(groups=[name + n for n in "123456"]))
    monkeypatch.setattr(dial, "measure", lambda instrument, string, nudge: [(string, nudge)])
    shares: list[float] = []
    assert dial.run(tell=shares.append) == [("a4", True), ("c4", True)]
    assert shares == [0.5, 1.0]
    assert dial.run(quick=True) == [("classical_guitar4", False)]


def points(name: str, draft: PartialErrors, standard: PartialErrors, seconds: float) -> list[DialPoint]:
    """Draft, standard, reference and the nudged one; the draft takes a quarter of the time of `standard`."""
    none = errors(0, 0, 0)
    rows = (
        ("draft", draft, seconds / 4), ("standard", standard, seconds), ("reference", none, 9.0), (dial.NUDGED, none, 9)
    )  # fmt: skip
    return [DialPoint(name, "A", label, e, s, 70, 1) for label, e, s in rows]


def test_a_section_has_the_errors_ratios_and_what_lies_outside() -> None:
    near, far = errors(0.5, 0.02, 0.25, waveform=0.125), errors(2.0, 0.04, 0.5, waveform=0.5)
    slow = [
        replace(p, seconds=p.seconds * (1 if p.accuracy == "standard" else 2)) for p in points("viol", far, near, 4)
    ]
    worse = errors(0.75, 0.0, 0.0)
    lyre = points("lyre", far, worse, 8.0)
    text = dial.section([*points("lute", far, near, 2.0), *slow, *lyre, *points("harp", near, far, 1.0)])
    cells = [[c.strip() for c in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| lute")]
    assert cells == [
        ["lute", "draft", "70", "2 / 4", "4 / 8", "0.5 / 1", "50", "0.5", "0.25"],
        ["lute", "standard", "70", "0.5 / 1", "2 / 4", "0.25 / 0.5", "12", "2", "1"],
        ["lute", "reference", "70", "", "", "", "", "9", "4.5"],
        ["lute", dial.NUDGED, "70", "0 / 0", "0 / 0", "0 / 0", "", "", ""],
    ]
    assert (
        "`standard` is within 1 cent, 5 % of the decay and 1 dB of `reference` in every partial on lute, viol; in the "
        "median of the partials on lyre (worst: 1.5 cents); not on harp (2 cents).\n\n"
        "`draft` takes 0.25 to 0.5 of the time of `standard`; it lies nearer to `reference`: harp (cents 2 against 0.5 "
        "cents, cents_worst 4 against 1 cents, decay 0.04 against 0.02, decay_worst 0.08 against 0.04, level 0.5 "
        f"against 0.25 dB, level_worst 1 against 0.5 dB, waveform 0.5 against 0.12).\n\n{dial.WHY}"
    ) in text
    assert "`standard`, and by no measure does it lie nearer" in dial.section(points("lute", far, near, 2.0))
    outside = dial.section(points("harp", far, far, 2.0))
    assert "in every partial on none; not on harp (2 cents)." in outside


@pytest.mark.parametrize(
    ("label", "fine", "wrong"),
    [("x", 1.1, 0), ("x", 1.101, 6), (dial.NUDGED, 1.5, 0), (dial.NUDGED, 1.51, 6), (dial.OTHERS, 1.5, 0)],
)
def test_chance_and_a_tenth_are_no_wrong_order(label: str, fine: float, wrong: int) -> None:
    chance = DialPoint("lute", "A", label, errors(0.4, 0.4, 0.4, worst=1), 1.0, 9, 1)
    both = points("lute", errors(1, 1, 1, worst=1), errors(fine, fine, fine, worst=1), 1.0)[:2]
    assert len(dial.out_of_order([*both, chance])) == wrong
    more = [replace(chance, accuracy=dial.OTHERS), replace(chance, accuracy=dial.NUDGED, errors=errors(0, 0, 0))]
    assert dial.out_of_order([*both, *more]) == ([] if fine <= 1.5 else dial.out_of_order([*both, more[0]]))


def test_effects_are_tabled_in_times_of_all() -> None:
    rows = [
        DialPoint("lute", "A", label, errors(e, e, e), seconds, 70, 1)
        for label, e, seconds in (("all", 0.0, 4.0), ("none", 0.5, 1.0))
    ]
    text = dial.budget_section(rows)
    assert text.startswith(dial.BUDGET_TEXT)
    table = [[c.strip() for c in line.split("|")[1:-1]] for line in text.splitlines()[-4:]]
    assert table[0] == [
        "instrument", "--effects", "modes", "cents", "decay %", "level dB", "waveform %", "s per s", "time ratio"
    ]  # fmt: skip
    assert table[2:] == [
        ["lute", "all", "70", "", "", "", "", "4", "1"],
        ["lute", "none", "70", "0.5 / 1", "50 / 1e+02", "0.5 / 1", "", "1", "0.25"],
    ]
    assert rows[1].to_dict()["cents_worst"] == 1.0
