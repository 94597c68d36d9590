"""Presets: names for options, and what a room does to channels and stems."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.sound.render.presets import BUILT_IN, with_preset
from tonewood.sound.room import ROOMS

pytest.importorskip("pyroomacoustics")
NOTES = tw.Score([tw.Note(0.0, 0.2, string="A2", stop=0, force=1.0)])


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    return tw.load_instrument("monochord")


@pytest.mark.parametrize("name", ["monochord", "classical_guitar"])
def test_dry_is_the_same_bits_and_studio_varies(name: str) -> None:
    """A note that is played twice differs from itself more in `studio`, beyond what still rings of the first."""
    made = tw.load_instrument(name)
    twice = tw.Score([tw.Note(t, 0.3, string=made.string_names[0], stop=0, velocity_midi=90) for t in (0.05, 0.45)])
    plain, dry, studio = (
        tw.render(twice, made, max_duration=0.8, fs=48000, **more).samples
        for more in ({}, {"preset": "dry"}, {"preset": "studio"})
    )
    assert np.array_equal(plain, dry)
    first, second = slice(2400, 12000), slice(21600, 31200)
    change = [np.square(x[first] - x[second]).sum() / np.square(x[first]).sum() for x in (dry, studio)]
    assert change[0] < 0.05 < 0.3 < change[1]


def test_options_that_are_given_come_first(monochord: tw.Instrument) -> None:
    chosen = with_preset(tw.RenderOptions(preset="studio", humanize=7, room_mix_db=-3.0), monochord.spec)
    assert (chosen.room, chosen.humanize, chosen.room_mix_db, chosen.noises) == ("studio", 7, -3.0, True)


def test_a_bundle_names_its_own(monochord: tw.Instrument) -> None:
    own = monochord.replace({"presets": {"studio": {"outputs": ["bridge"], "room": "small"}, "near": {"humanize": 3}}})
    assert with_preset(tw.RenderOptions(preset="studio"), own.spec).room == "small"
    assert with_preset(tw.RenderOptions(preset="near"), own.spec).humanize == 3
    assert BUILT_IN["studio"].room == "studio"
    with pytest.raises(TonewoodError, match="'far'; dry, studio, stage, near are allowed"):
        tw.Renderer(NOTES, own, preset="far")


@pytest.mark.parametrize(
    ("preset", "said"),
    [
        ({"room": "../../response.wav"}, "presets.own.room: Input should be 'studio', 'small' or 'hall'"),
        ({"outputs": ["bridge", "brige"]}, "presets.own.outputs: there is no output 'brige'; did you mean bridge"),
    ],
)
def test_a_bundle_names_rooms_and_outputs_that_there_are(monochord: tw.Instrument, preset: object, said: str) -> None:
    """A file of the user's computer is the user's to name, by `--room`: bundles come from others."""
    with pytest.raises(TonewoodError, match=said):
        monochord.replace({"presets": {"own": preset}})
    assert set(ROOMS) == {"studio", "small", "hall"}
    for room in ROOMS:
        assert monochord.replace({"presets": {"own": {"room": room}}}).spec.presets["own"].room == room


def test_a_room_turns_one_channel_into_two(monochord: tw.Instrument) -> None:
    """The direct sound is that of the dry render, on both sides, half a millisecond late."""
    dry = tw.Renderer(NOTES, monochord, max_duration=0.1, fs=16000)
    wet = tw.Renderer(NOTES, monochord, max_duration=0.1, fs=16000, room="small", room_mix_db=-100.0)
    assert wet.channels == tuple(f"{dry.channels[0]}_{side}" for side in ("left", "right"))
    x, y = (np.concatenate(list(r.blocks(512))) for r in (dry, wet))
    assert y.shape == (len(x), 2)
    assert np.allclose(y[:, 0], y[:, 1], atol=0.02 * np.abs(x).max())
    share = [np.corrcoef(x[:-8, 0], y[k : len(y) - 8 + k, 0])[0, 1] for k in range(8, 9)]
    assert share[0] > 0.99
    assert "not measured" in str(wet.summary().room)


def test_a_snapshot_holds_the_room(monochord: tw.Instrument) -> None:
    """To the last bit, and whatever the blocks."""
    make = {"max_duration": 0.5, "fs": 16000, "room": "small"}
    whole = np.concatenate(list(tw.Renderer(NOTES, monochord, **make).blocks(100)))
    renderer = tw.Renderer(NOTES, monochord, **make)
    first = [block for _, block in zip(range(3), renderer.blocks(700), strict=False)]
    kept = renderer.snapshot()
    rest = list(renderer.blocks(5000))
    assert np.array_equal(np.concatenate(first + rest), whole)
    renderer.restore(kept)
    assert np.array_equal(np.concatenate(list(renderer.blocks(5000))), np.concatenate(rest))


def test_the_room_rings_on(monochord: tw.Instrument) -> None:
    """After a dry end there is the rest of the reverberation, which `max_duration` cuts."""
    ends = {"fs": 16000, "tail": 0.0}
    dry, wet = (tw.render(NOTES, monochord, **ends, **more).samples for more in ({}, {"room": "small"}))
    assert len(wet) > len(dry) + 0.2 * 16000
    assert len(tw.render(NOTES, monochord, **ends, room="small", max_duration=0.1).samples) == 1600
