"""Two users of one sound: refused, since each would get pieces of it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError

FS = 16000


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    return tw.load_instrument("monochord")


def renderer(monochord: tw.Instrument, pitch: int = 45, fs: float = FS) -> tw.Renderer:
    return tw.Renderer(tw.Score([tw.Note(0.0, 0.2, note=pitch, force=1.0)]), monochord, fs, max_duration=0.2)


def in_a_thread(call: Callable[[], Any]) -> Any:
    """Result of a call in another thread, or its error."""
    results: list[Any] = []

    def run() -> None:
        try:
            results.append(call())
        except TonewoodError as error:
            results.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return results[0]


def test_six_threads_on_one_renderer_get_one_sound_and_five_errors(monochord: tw.Instrument) -> None:
    """The first has begun when the others come, and goes on undisturbed."""
    shared, whole = renderer(monochord), np.concatenate(list(renderer(monochord).blocks(256)))
    begun = shared.blocks(256)
    first = [next(begun)]
    errors = [in_a_thread(lambda: list(shared.blocks(256))) for _ in range(5)]
    for error in errors:
        assert isinstance(error, TonewoodError)
        assert "taken by another thread; each needs one of its own" in str(error)
    assert np.array_equal(np.concatenate(first + list(begun)), whole)
    assert in_a_thread(lambda: list(shared.blocks(256))) == []  # that one has ended


def test_an_iteration_is_handed_on_to_another_thread(monochord: tw.Instrument) -> None:
    whole = np.concatenate(list(renderer(monochord).blocks(256)))
    begun = renderer(monochord).blocks(256)
    first = next(begun)
    assert np.array_equal(np.concatenate([first, *in_a_thread(lambda: list(begun))]), whole)


def test_the_older_of_two_iterations_is_refused(monochord: tw.Instrument) -> None:
    """Two generators in one thread would take turns; the later one goes on where the first was left."""
    shared, whole = renderer(monochord), np.concatenate(list(renderer(monochord).blocks(256)))
    old = shared.blocks(256)
    first = next(old)
    new = shared.blocks(256)
    second = next(new)
    with pytest.raises(TonewoodError, match="another iteration over the blocks of this renderer has begun since"):
        next(old)
    assert np.array_equal(np.concatenate([first, second, *new]), whole)


def test_a_block_that_is_being_made_is_not_disturbed(monochord: tw.Instrument) -> None:
    """Snapshots, iterations and calls of a live instrument from another thread while a block is made."""
    shared, live, errors = renderer(monochord), tw.Live(monochord, FS, prepare=False), list[Any]()
    advance, feed = shared.engine.advance, live.player.feed
    at_start = shared.snapshot()

    def during_render(points: int) -> Any:
        others = (shared.snapshot, lambda: shared.restore(at_start), lambda: next(shared.blocks(64)))
        errors.extend(in_a_thread(call) for call in others)
        shared.engine.advance = advance  # type: ignore[method-assign]
        return advance(points)

    def during_process(*arguments: Any) -> Any:
        others = (
            lambda: live.note_on(45), lambda: live.note_off(45), lambda: live.control(64, 1.0),
            lambda: live.bend(10.0), lambda: live.pressure(0.5), live.all_off, live.release_keys,
            lambda: live.process(64),
        )  # fmt: skip
        errors.extend(in_a_thread(call) for call in others)
        live.player.feed = feed  # type: ignore[method-assign]
        return feed(*arguments)

    shared.engine.advance = during_render  # type: ignore[method-assign]
    live.player.feed = during_process  # type: ignore[method-assign]
    next(shared.blocks(64))
    live.process(64)
    assert len(errors) == 11
    assert all("thread" in str(error) for error in errors if isinstance(error, TonewoodError))
    assert [type(error) for error in errors] == [TonewoodError] * 11
    live.note_on(45)  # free again
    assert len(in_a_thread(lambda: live.process(64))) == 64


def test_one_instrument_has_one_stream_and_a_stream_one_beginning(monochord: tw.Instrument) -> None:
    live = tw.Live(monochord, FS, prepare=False)
    with tw.AudioStream(live, 64) as stream:
        with pytest.raises(TonewoodError, match="played by another stream"):
            tw.AudioStream(live, 64).start()
        with pytest.raises(TonewoodError, match="was started before"):
            stream.start()
    with tw.AudioStream(live, 64):
        pass
    shared = renderer(monochord)
    begun = shared.blocks(64)
    next(begun)
    with pytest.raises(TonewoodError, match="taken by another thread"):
        tw.AudioStream(shared, 64).start()


def test_an_error_in_the_callback_ends_the_stream_and_is_raised(monochord: tw.Instrument) -> None:
    """A processor that gives other channels than the card has: the card would only fall silent."""

    class Card:
        latency = 0.0

        def __init__(self, **options: Any) -> None:
            self.options = options

        def __enter__(self) -> Card:
            with contextlib.suppress(ValueError):  # as a sound card's own thread: the error goes no further
                self.options["callback"](np.zeros((64, 2), np.float32), 64, None, None)
            return self

        def __exit__(self, *_: object) -> None:
            pass

    stream = tw.AudioStream(tw.Live(monochord, FS, prepare=False), 64, chain=[lambda block, fs: np.zeros((64, 3))])
    with pytest.raises(ValueError, match="broadcast"):
        stream.play(stream=Card)


def test_a_snapshot_of_a_render_of_something_else_is_refused(monochord: tw.Instrument) -> None:
    """Of one string all arrays have the same shapes, at any rate, so that the samples would be wrong without a word."""
    kept = renderer(monochord).snapshot()
    nearer = monochord.replace({"exciters.pluck.from_bridge": 0.05})
    others = {
        "options": renderer(monochord, fs=FS / 2),
        "values of the instrument": renderer(nearer),
        "notes": renderer(monochord, pitch=47),
    }
    for name, other in others.items():
        with pytest.raises(TonewoodError, match=f"^checkpoint: is of a renderer with other {name}$"):
            other.restore(kept)
    again, whole = renderer(monochord), np.concatenate(list(renderer(monochord).blocks(256)))
    again.restore(kept)
    assert np.array_equal(np.concatenate(list(again.blocks(256))), whole)
