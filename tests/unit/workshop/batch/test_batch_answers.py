"""A test to which answers were given stays as it is; levels of staircases are made before anybody listens."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import batch_fakes as fakes
import numpy as np
import pytest
import soundfile
from batch_fakes import FakeRenderer

from tonewood.errors import NumericalError, OutputError, TonewoodError
from tonewood.support.folder_lock import locked
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.batch.runner import plan_batch, run_batch

SMALL: dict[str, Any] = {
    "scores": {"low": {"phrase": [{"time": 0.0, "freq": 220.0, "force": 1.0}]}},
    "pages": [{"type": "mushra", "group_by": ["score"], "reference": {"damping": "complex", "pluck": "near"},
               "strict": False}],
    "repeats": 1, "vary": {}, "exclude": [], "output": {"formats": ["test", "json"]},
}  # fmt: skip
STAIRS: dict[str, Any] = {
    "type": "staircase", "path": "body.t60", "of": {"damping": "complex", "pluck": "near"},
    "scale": "value", "start": 0.2, "lowest": 0.1, "highest": 0.4, "steps": [0.05], "reference": 0.05,
}  # fmt: skip


def files(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        path.relative_to(folder).as_posix(): (path.stat().st_mtime_ns, path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_batch_does_not_replace_a_test_under_its_answers(tmp_path: Path) -> None:
    path, out = fakes.write(tmp_path, fakes.manifest(**SMALL)), tmp_path / "out"
    run_batch(path, out, FakeRenderer())
    answers = out / "answers"
    answers.mkdir()
    (answers / "1.jsonl").write_text('{"listener": "begun, nothing answered"}\n')
    fakes.write(tmp_path, fakes.manifest(**SMALL, title="first"))
    assert run_batch(path, out, FakeRenderer()).ok
    (answers / "1.jsonl").write_text("{}\n{}\n{}\n")
    before = files(out)
    line = r"test\.json: 2 answers were given to this test, and .* would be replaced: take another folder with -o"
    for change, renderer in (
        ({"title": "second"}, FakeRenderer()),
        ({"seed": 99}, FakeRenderer()),
        ({"factors": fakes.manifest()["factors"] | {"more": {"path": "body.x", "levels": {"a": 1}}}}, FakeRenderer()),
        ({"title": "first"}, FakeRenderer(version="2")),  # the same test, but of other sounds
    ):
        fakes.write(tmp_path, fakes.manifest(**SMALL) | change)
        for run in (run_batch, plan_batch):
            with pytest.raises(ManifestError, match=line):
                run(path, out, renderer)
    assert files(out) == before
    fakes.write(tmp_path, fakes.manifest(**SMALL, title="first"))
    assert run_batch(path, out, FakeRenderer()).rendered == 0  # the same test and sounds again
    test = (out / "test.json").read_bytes()
    assert test == before["test.json"][1]
    (out / "test.json").write_text("{")
    with pytest.raises(ManifestError, match=line):
        run_batch(path, out, FakeRenderer())
    (out / "test.json").write_bytes(test)
    fakes.write(tmp_path, fakes.manifest(**SMALL, title="second"))
    answers.rename(out / "answers of the first")
    assert run_batch(path, out, FakeRenderer()).ok


def test_a_room_under_its_name_is_not_replaced_under_answers(tmp_path: Path) -> None:
    room, out = tmp_path / "room.wav", tmp_path / "out"
    soundfile.write(room, np.array([1.0, 0.5]), 48000)
    path = fakes.write(tmp_path, fakes.manifest(**SMALL, stimuli={"room": "room.wav"}))
    run_batch(path, out, FakeRenderer())
    (out / "answers").mkdir()
    (out / "answers" / "1.jsonl").write_text("{}\n{}\n")
    assert run_batch(path, out, FakeRenderer()).ok
    soundfile.write(room, np.array([1.0, -0.5]), 48000)
    before = files(out)
    with pytest.raises(ManifestError, match=r"1 answers were given to this test, and test\.json would be replaced"):
        run_batch(path, out, FakeRenderer())
    assert files(out) == before


def test_what_is_no_file_of_answers_stops_no_batch_and_one_that_cannot_be_read_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, out = fakes.write(tmp_path, fakes.manifest(**SMALL)), tmp_path / "out"
    (out / "answers" / "folder.jsonl").mkdir(parents=True)
    if hasattr(os, "mkfifo"):
        os.mkfifo(out / "answers" / "pipe.jsonl")
    assert run_batch(path, out, FakeRenderer()).ok
    (out / "answers" / "1.jsonl").write_text("{}\n{}\n")
    fakes.write(tmp_path, fakes.manifest(**SMALL, title="second"))
    read = Path.read_bytes

    def away(self: Path) -> bytes:
        if self.name == "1.jsonl":
            raise PermissionError(13, "Permission denied")
        return read(self)

    monkeypatch.setattr(Path, "read_bytes", away)
    with pytest.raises(ManifestError, match=r"1\.jsonl: cannot be read: Permission denied; there may be answers"):
        run_batch(path, out, FakeRenderer())


def test_a_batch_does_not_write_under_a_server(tmp_path: Path) -> None:
    path, out = fakes.write(tmp_path, fakes.manifest(**SMALL)), tmp_path / "out"
    run_batch(path, out, FakeRenderer())
    before = files(out)
    with locked(out, "tonewood serve"), pytest.raises(OutputError, match="is in use by tonewood serve, process"):
        run_batch(path, out, FakeRenderer(version="2"))
    assert files(out) == before


def test_a_level_that_a_setting_of_the_render_cannot_have_is_one_line(tmp_path: Path) -> None:
    rate = {"path": "render.fs", "scale": "add", "start": 0.5, "lowest": 0.0, "highest": 1.0, "steps": [0.25]}
    rate |= {"reference": 48000}
    path = fakes.write(tmp_path, fakes.manifest(**SMALL | {"pages": [STAIRS | rate]}))
    with pytest.raises(ManifestError, match=r"page 1\.start: the level cannot be rendered: render\.fs: ") as caught:
        plan_batch(path, tmp_path / "out", FakeRenderer())
    assert "\n" not in str(caught.value)


class Limited(FakeRenderer):
    """Refuses one value of a parameter: as it is set, or as it is rendered, or only in a whole render."""

    def __init__(self, refused: float, where: str):
        super().__init__()
        self.refused, self.where = refused, where

    def own_value(self, condition: Any, path: str) -> Any:
        value = super().own_value(condition, path)
        if self.where == "set" and value == self.refused:
            raise TonewoodError("a value above 0 is wanted")
        return value

    def render(self, condition: Any) -> Any:
        if self.where == "rendered" and condition.overrides.get("body.t60") == self.refused:
            raise NumericalError("not finite at 0.1 s")
        if self.where == "mistake" and condition.overrides.get("body.t60") == self.refused:
            raise ZeroDivisionError("of a plugin")
        return super().render(condition)


@pytest.mark.parametrize("where", ["set", "rendered", "mistake"])
@pytest.mark.parametrize("name", ["reference", "start", "lowest", "highest"])
@pytest.mark.parametrize("predict", [True, False])
def test_each_level_of_a_staircase_is_made_beforehand(tmp_path: Path, name: str, where: str, predict: bool) -> None:
    path = fakes.write(tmp_path, fakes.manifest(**SMALL | {"pages": [STAIRS]}))
    with pytest.raises(ManifestError, match=rf"page 1\.{name}: the level cannot be rendered: ") as caught:
        plan_batch(path, tmp_path / "out", Limited(STAIRS[name], where), predict=predict)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()
    levels = [level.condition.name for level in plan_batch(path, tmp_path / "out", FakeRenderer()).levels]
    assert len(set(levels)) == 4


def test_levels_that_are_silent_or_not_finite_are_reported(tmp_path: Path) -> None:
    class Silent(FakeRenderer):
        def render(self, condition: Any) -> Any:
            sound = super().render(condition)
            if condition.overrides.get("body.t60") == STAIRS["lowest"]:
                sound.samples[:] = 0.0
            return sound

    path = fakes.write(tmp_path, fakes.manifest(**SMALL | {"pages": [STAIRS]}))
    report = run_batch(path, tmp_path / "out", Silent())
    assert [fault.name.rpartition("(")[2] for fault in report.faults] == ["page 1.lowest)"]
    for change in (
        {"scale": "db", "reference": 0.1, "highest": 1e6, "steps": [1e3]},
        {"scale": "percent", "highest": float("inf")},
    ):
        fakes.write(tmp_path, fakes.manifest(**SMALL | {"pages": [STAIRS | change]}))
        with pytest.raises(ManifestError, match=r"page 1\.highest"):
            plan_batch(path, tmp_path / "out", FakeRenderer())


@pytest.mark.parametrize(
    "change",
    [
        {"scale": "percent", "reference": 0.0},
        {"scale": "db", "reference": 0},
        {"scale": "add", "reference": 1e20},
        {"scale": "percent", "reference": 0.0, "steps": []},
    ],
)
def test_levels_that_leave_the_parameter_where_it_is_are_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    path = fakes.write(tmp_path, fakes.manifest(**SMALL | {"pages": [STAIRS | change]}))
    with pytest.raises(ManifestError, match=r"page 1\.scale: .* is .* at the lowest and at the highest level"):
        plan_batch(path, tmp_path / "out", FakeRenderer())


def test_levels_are_in_the_store_when_the_first_listener_comes(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(**SMALL | {"pages": [STAIRS]}))
    assert run_batch(path, tmp_path / "out", FakeRenderer()).ok
    again = plan_batch(path, tmp_path / "out", FakeRenderer())
    assert again.todo == ()
    assert len(again.levels) == 4
