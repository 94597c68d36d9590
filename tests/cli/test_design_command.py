"""``tonewood design`` through the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli_runs import refused
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
