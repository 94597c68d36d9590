"""``tonewood design`` through the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cli_runs import Asked, refused, told
from tonewood import load_instrument

Run = Callable[..., tuple[int, str, str]]

PLATE = {"outline": {"points": [[0, 0], [0.4, 0], [0.4, 0.15], [0, 0.15]]}, "wood": {"species": "sitka_spruce"},
         "thickness": 4.0e-3, "edge": {"kind": "free"}, "fmax": 300.0, "plugin": "drawn_body"}  # fmt: skip


def test_the_string_set_without_a_wolf_is_chosen(tonewood: Run) -> None:
    """K grows with the root of a string's mass: heavy steel strings have a wolf where light nylon ones have none."""
    wolf = ["--target", "no wolf G4..A#4", "--free", "strings=ej16,ej45", "--json"]
    code, out, _ = tonewood("design", "classical_guitar", *wolf)
    report = json.loads(out)
    assert (code, report["strings"], report["targets"][0]["reached"]) == (0, "ej45", True)
    assert tonewood("design", "classical_guitar", *wolf[:2], "--free", "strings=ej16")[0] == 1


@pytest.mark.slow
def test_modes_of_a_free_plate_are_counted_without_its_rigid_motion(tonewood: Run, tmp_path: Path) -> None:
    """The first mode of a free plate is proportional to its thickness, nearly."""
    text = {"schema": "tonewood-instrument/2", "name": "top", "body": PLATE}
    (tmp_path / "instrument.yaml").write_text(json.dumps(text))
    freq = load_instrument(tmp_path).body.basis(1000.0).natural_freq
    wanted = ["--target", "mode 1 = 110", "--free", "body.thickness=3e-3:6e-3", "--json"]
    code, out, _ = tonewood("design", tmp_path, *wanted)
    report = json.loads(out)
    now, designed = report["targets"][0]["now"], report["targets"][0]["designed"]
    assert code == 0
    assert np.count_nonzero(freq == 0) == 3
    assert now == pytest.approx(freq[freq > 0].min(), rel=1e-9)
    assert designed == pytest.approx(110, rel=5e-3)
    assert report["parameters"][0]["designed"] / 4e-3 == pytest.approx(designed / now, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], ["there are 0; 1 to 40 are allowed"]),
        (["--free", "strings=none_such"], ["there is no string set 'none_such'"]),
        (["--free", "strings=ej45", "--strings", "ej46"], ["--strings", "one of the two"]),
        (["--free", "body.added.0.mass=2:1"], ["LOW below HIGH"]),
    ],
)
def test_commands_refuse(tonewood: Run, arguments: list[str], said: list[str]) -> None:
    refused(tonewood("design", "classical_guitar", "--target", "no wolf F3..A3", *arguments), *said)


def test_the_cheapest_of_several_designs_is_told(
    tonewood: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A string set that misses its target, and one that reaches it, with a free mass."""
    from tonewood.cli import design
    from tonewood.workshop.design import folder, search, words

    asked: list[Any] = []

    def found(instrument: Any, targets: Any, free: Any, tell: Any) -> Any:
        asked.append((instrument.spec.strings_from, [t.text for t in targets], [p.name for p in free]))
        tell("a step")
        first = len(asked) % 2 == 1
        return SimpleNamespace(
            cost=2.0 if first else 0.5, ok=not first, targets=targets, off=[1e9 if first else 0.0], free=free,
            values=[0.004 if first else 0.02],
        )  # fmt: skip

    written = Asked()
    monkeypatch.setattr(search, "find_design", found)
    monkeypatch.setattr(folder, "write_design", written)
    monkeypatch.setattr(words, "lines", lambda best: ["as designed"])
    monkeypatch.setattr(design, "_report", lambda best, output: {"cost": best.cost, "output": str(output)})
    call = (
        "design",
        "classical_guitar",
        "--set",
        "body.added=[{at: bridge_E2, mass: 0.001}]",
        "--target",
        "mode 1 = 100",
    )
    call += ("--free", "strings=ej16, ej45", "--free", "body.added.0.mass=0.001:0.05", "-o", tmp_path / "made")
    code, out, err = tonewood(*call)
    assert (code, err) == (0, "design: a step\n" * 2)
    assert [row[0] for row in asked] == ["ej16", "ej45"]
    assert asked[0][1:] == (["mode 1 = 100"], ["body.added.0.mass"])
    assert out.splitlines() == [
        "strings ej16: misses mode 1 = 100", "strings ej45: reach all targets", "with strings ej45", "as designed",
        "for render and compare: --strings ej45 --set body.added.0.mass=0.02", f"bundle: {tmp_path / 'made'}",
    ]  # fmt: skip
    assert (written.words[0].cost, written.words[1]) == (0.5, tmp_path / "made")
    report = told((*tonewood(*call, "--json")[:2], ""))
    assert (report["cost"], report["strings"], report["ok"]) == (0.5, "ej45", True)
    code, out, _ = tonewood(*call[:6], "--free", "body.added.0.mass=0.001:0.05")  # misses its target
    assert (code, out.splitlines()) == (1, ["as designed", "for render and compare: --set body.added.0.mass=0.004"])
    refused(tonewood(*call[:6], "--free", "body.added.0.mass"), "PATH=LOW:HIGH is allowed")


def test_a_free_parameter_is_given_once(tonewood: Run) -> None:
    """Of two bounds none is chosen."""
    words = ("--target", "T1 = 200", "--free", "body.thickness=2e-3:3e-3", "--free", "body.thickness=2e-3:4e-3")
    code, _, err = tonewood("design", "drawn_guitar", *words)
    assert (code, err) == (2, "tonewood: --free body.thickness: is there twice; once is allowed\n")
