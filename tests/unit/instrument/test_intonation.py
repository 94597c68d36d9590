"""Real frets in an instrument: pitch by geometry, on the body, in the render and on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

import tonewood as tw
from sounds import partial
from tonewood.authoring import assemble
from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.intonation import intonation
from tonewood.support.units import cents

Make = Callable[..., Instrument]
#: a stiff string on a rigid end, high over its frets
HIGH = {
    "tuning.at": "frets",
    "strings.*.fretting_stiffness": 6000.0,
    "strings.*.bending_stiffness": 3e-4,
    "strings.*.end_compliance": 0.0,
    "stops.kind": "frets",
    "stops.count": 14,
    "stops.fretboard.nut_height": 1e-3,
    "stops.fretboard.saddle_height": 6e-3,
}
RIGID = {"body.points.bridge.direction": "y", "strings.*.polarizations": ["z"]}


def test_a_string_on_a_rigid_end_sounds_as_the_geometry_says(make: Make) -> None:
    string = assemble(make().replace(HIGH | RIGID), 16000.0).strings["A2"]
    fretted = string.stopping.fretted
    assert fretted is not None
    assert abs(string.tuned(0).error_cents) < 0.01
    for stop in (1, 5, 12, 14):
        sounding = string.tuned(stop).modes[0].freq / string.tuned(0).modes[0].freq
        assert cents(sounding / fretted.ratio(stop)) == pytest.approx(0.0, abs=0.05)
        assert cents(sounding) - 100 * stop > 1.0


def test_without_height_and_stiffness_nothing_changes(make: Make) -> None:
    flat = {"strings.*.bending_stiffness": 0.0, "stops.fretboard.nut_height": 0.0, "stops.fretboard.saddle_height": 0.0}
    exact = make().replace(HIGH | RIGID | flat)
    frets, decree = (assemble(exact.replace({"tuning.at": at}), 16000.0).strings["D3"] for at in ("frets", "each_stop"))
    for stop in range(15):
        assert frets.length(stop) == pytest.approx(decree.length(stop), rel=1e-12)
        assert frets.tension(stop) == pytest.approx(decree.tension(stop), rel=2e-5)


def test_the_default_is_tuning_by_decree(make: Make) -> None:
    """Keys of the fretboard alone change no tension."""
    plain = make().replace({"stops.kind": "frets", "stops.count": 14})
    stated = plain.replace({k: v for k, v in HIGH.items() if "fretboard" in k or "fretting" in k})
    one, other = (assemble(x, 16000.0).strings["A2"] for x in (plain, stated))
    assert [one.tension(i) for i in range(15)] == [other.tension(i) for i in range(15)]


def test_the_rendered_sound_has_this_pitch() -> None:
    """Frequencies measured in the sound, against coupled modes and against geometry."""
    guitar = tw.load_instrument("monochord").replace(
        {
            "stops": {"kind": "frets", "count": 19, "fretboard": {"nut_height": 1e-3, "saddle_height": 7e-3}},
            "tuning.at": "frets",
            "strings.A2.fretting_stiffness": 12000.0,
            "strings.A2.bending_stiffness": 4e-4,
            "strings.A2.polarizations": ["z"],
        }
    )
    string = assemble(guitar, 48000.0).strings["A2"]
    fretted = string.stopping.fretted
    assert fretted is not None
    for stop in (0, 3, 12):
        tuned = string.tuned(stop)
        sound = tw.render(tw.Score([tw.Note(0.0, 1.5, string="A2", stop=stop, force=0.5)]), guitar).samples[9600:, 0]
        freq, _ = partial(sound, 48000.0, tuned.modes[0].freq)
        assert cents(freq / tuned.modes[0].freq) == pytest.approx(0.0, abs=0.05)
        assert cents(freq / string.freq(0) / fretted.ratio(stop)) == pytest.approx(0.0, abs=3.0)
        if stop:
            assert cents(freq / string.freq(stop)) > 3.0


@pytest.mark.slow
def test_frets_of_a_connection_give_the_action() -> None:
    """`steel_strings` states action and relief for its buzz; its own keys come first."""
    steel = tw.load_instrument("steel_strings")
    low = steel.replace({"connections.frets.action_twelfth": 1.2e-3})
    own = steel.replace({"strings.E2.fretboard.action_twelfth": 1.2e-3})
    rows = {
        n: {s.name: s.stops[11].stretch for s in intonation(x)} for n, x in (("", steel), ("low", low), ("own", own))
    }
    assert all(rows["low"][name] < rows[""][name] for name in rows[""])
    assert rows["own"]["E2"] == pytest.approx(rows["low"]["E2"])
    assert rows["own"]["A2"] == pytest.approx(rows[""]["A2"])


@pytest.mark.slow
def test_the_best_nut_and_saddle_even_the_frets_out() -> None:
    found = intonation(tw.load_instrument("classical_guitar"))
    changes = {}
    for s in found:
        assert s.both is not None
        assert s.saddle_alone is not None
        assert s.both.rms < 0.3 < s.saddle_alone.rms < 1.0 < s.built.rms
        changes[f"strings.{s.name}.fretboard.nut_setback"] = s.both.nut_setback
        changes[f"strings.{s.name}.fretboard.saddle_setback"] = s.both.saddle_setback
    for s in intonation(tw.load_instrument("classical_guitar").replace(changes)):
        assert s.built.rms < 0.3
        assert [stop.rigid for stop in s.stops[:12]] == pytest.approx(list(s.built.cents))


def test_given_places_and_an_old_rule(make: Make) -> None:
    places = [0.65 * (1 - (17 / 18) ** n) for n in range(1, 15)]
    rows = [
        intonation(make().replace(HIGH | {f"stops.fretboard.{key}": value}), fs=16000.0)[0]
        for key, value in (("places", places), ("rule", 18.0))
    ]
    assert [s.frets for s in rows[0].stops] == pytest.approx([s.frets for s in rows[1].stops], abs=1e-9)
    # the plane that the body moves least has the sum of the three, where no mode of the body is near
    assert np.median([abs(stop.rigid - stop.planes["A2.z"]) for stop in rows[0].stops]) < 1.0
    assert rows[0].stops[11].frets == pytest.approx(-1200 * 12 * np.log2(17 / 18) - 1200, abs=0.6)


@pytest.mark.parametrize(
    ("changes", "shown"),
    [
        ({"stops.kind": "continuous"}, "tuning.at: frets wants stops.kind: frets, which is continuous"),
        ({"tuning.compensate": "none"}, "frets wants tuning.compensate: coupled"),
        ({"strings.*.fretting_stiffness": None}, "strings.A2.fretting_stiffness: is missing"),
        ({"stops.fretboard.nut_height": None}, "stops.fretboard.nut_height: is missing; it or `action_first`"),
        ({"stops.fretboard.action_first": 1e-3}, "action_first: stands beside `nut_height`"),
        ({"stops.fretboard.places": [0.1, 0.05]}, "stops.fretboard: places: do not rise"),
        ({"stops.fretboard.places": [0.1, 0.2]}, "has 2 frets up to 0.2 m; 14 below 0.65 m are wanted"),
        ({"stops.fretboard.saddle_height": 0.0, "stops.fretboard.heights": {"3": 2e-3}},
         "lets the open string A2 lie on fret 3"),
        ({"stops.fretboard.nut_height": 1.0}, "stops.fretboard.nut_height: .*at most 0.02"),
    ],
)  # fmt: skip
def test_fretboards_that_cannot_be(make: Make, changes: dict[str, object], shown: str) -> None:
    with pytest.raises(TonewoodError, match=shown) as fault:
        assemble(make().replace({**HIGH, **changes}), 16000.0)
    assert "\n" not in str(fault.value)


@pytest.mark.slow
def test_the_command_prints_cents_planes_and_setbacks(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["intonation", "classical_guitar", "--set", "strings.E4.fretboard.heights={'7': 1.0e-3}"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "fret       E2       A2" in out
    assert "warning: string E4 pressed to fret 6 lies on fret 7, which stands out" in out
    assert "best nut and saddle" in out
    with pytest.raises(SystemExit):
        run(["intonation", "classical_guitar", "--json", "--frets", "5"])
    report = json.loads(capsys.readouterr().out)
    e2 = report["strings"][0]
    assert len(e2["setups"]["both"]["cents"]) == 5
    assert set(e2["stops"][0]["planes"]) == {"E2.z", "E2.y"}
    first = e2["stops"][0]
    assert first["cents"] == pytest.approx(first["frets"] + first["stretch"] + first["stiffness"])
