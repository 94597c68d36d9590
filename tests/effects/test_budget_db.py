"""`budget_db` against the difference of samples, on random instruments that are light, sharp and in unison."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_scenes import difference, instrument_of, rendered, scene

import tonewood as tw

#: dB re the loudest sample; the instruments' own budget is as much
BUDGET = -80.0
#: of the default tier: without what culling does to partials in use, 18, 20 and 21 missed it by 2, 1 and 15 dB
SEEDS = (1, 11, 18, 20, 21, 26, 29, 78)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_scene_is_within_its_budget(seed: int, tmp_path: Path) -> None:
    error, _, culled = difference(*scene(seed, tmp_path))
    assert culled > 0.0
    assert error < BUDGET


@pytest.mark.validate
@pytest.mark.parametrize("seed", range(300))
def test_random_scenes_are_within_their_budget(seed: int, tmp_path: Path) -> None:
    error, reported, _ = difference(*scene(seed, tmp_path))
    assert error < BUDGET
    # what is reported is an estimate: it may be passed, but not by much
    assert error < reported + 6.0


def test_partials_of_strings_in_unison_on_a_light_body_keep_their_phase(tmp_path: Path) -> None:
    """Modes of Q 1300 to 3100 and 42 to 88 g, read as a displacement: -57 dB where only what is culled is counted."""
    rows = [
        (330.0656, 1324.24, 0.0449934, -0.1195508, -0.4134774, 0.6738830),
        (769.8980, 1465.03, 0.0878049, 0.6957883, -0.3122467, 0.2382842),
        (1885.5507, 1698.63, 0.0524878, 0.8045817, -0.2816761, 0.1094315),
        (2026.8272, 3109.39, 0.0469686, -0.1128828, 0.3005305, 0.9195417),
        (2442.2717, 1910.69, 0.0425657, -0.7227526, 0.9307707, 0.3314670),
    ]
    losses = {"s1": 1.7820305, "s2": 0.7893470, "s3": 2.5983484}
    strings = {n: (45.0 if n != "s3" else 57.0, s, 2e-4) for n, s in losses.items()}
    made = instrument_of(tmp_path, rows, strings, 0.15, "displacement", "s1")
    notes = [(0.1, "s1", 0.3357157), (0.6, "s3", 0.0401211), (6.6, "s3", 2.6720149)]
    score = tw.Score([tw.Note(t, 4.0, string=name, stop=0, force=force) for t, name, force in notes])
    assert difference(made, score, 11.0)[0] < BUDGET


@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
def test_forces_held_for_a_step_turn_no_partial_beyond_the_budget(quantity: str, tmp_path: Path) -> None:
    """One mode of Q 50 and 0.2 kg: -79.3 dB read as a displacement where that is not counted."""
    rows = [(1200.0, 50.0, 0.2, 1.0, 1.0)]
    made = instrument_of(tmp_path, rows, {"s1": (45.0, 0.3, 2e-4), "s2": (52.0, 0.3, 2e-4)}, 0.15, quantity, "s1")
    score = tw.Score([tw.Note(0.1, 9.0, string="s1", stop=0, force=0.5)])
    error, _, culled = difference(made, score, 9.0)
    assert culled > 0.0
    assert error < BUDGET - 10.0


def test_nothing_is_watched_where_no_rest_pays_for_it(tmp_path: Path) -> None:
    """What is left out then is nothing: `auto` makes what `all` does, in the same steps."""
    made, score, seconds = scene(2, tmp_path)
    streams = [tw.Renderer(score, made, 48000, max_duration=seconds, effects=mode) for mode in ("auto", "all")]
    assert not streams[0].engine.sleeper.worthwhile
    a, b = (np.concatenate(list(stream.blocks(4096))) for stream in streams)
    assert np.array_equal(a, b)
    assert "_listening" not in vars(streams[0].engine.sleeper)  # not even made
    assert streams[0].engine.ledger.mode_samples == streams[1].engine.ledger.mode_samples


@pytest.mark.parametrize(("rest", "watched"), [(1.0, False), (600.0, True)])
def test_what_is_watched_follows_from_the_rests_of_the_score(rest: float, watched: bool, tmp_path: Path) -> None:
    made, _, _ = scene(2, tmp_path)
    notes = [tw.Note(0.1, 0.5, string="s1", stop=0), tw.Note(0.1 + rest, 0.5, string="s1", stop=0)]
    sleeper = tw.Renderer(tw.Score(notes), made, 48000, effects="auto").engine.sleeper
    foreseen = 0.1 * sleeper.model.n_modes * 48000 * rest  # a tenth of all steps
    assert (foreseen >= sleeper.worth * len(sleeper.names)) == watched
    assert sleeper.worthwhile == watched
    # and no tail that ends above the budget counts, however long it might be
    for level, counts in ((-60.0, False), (-120.0, True)):
        stream = tw.Renderer(tw.Score(notes[:1]), made, 48000, effects="auto", tail=600.0, tail_level_db=level)
        assert stream.engine.sleeper.worthwhile == counts


def test_a_rest_that_pays_is_taken(tmp_path: Path) -> None:
    made, _, _ = scene(2, tmp_path)
    score = tw.Score([tw.Note(0.1, 0.5, string="s1", stop=0, force=1.0)])
    sound, stream = rendered(made, score, 3.0, "auto")
    assert stream.engine.ledger.mode_samples <= len(sound) * stream.model.n_modes
