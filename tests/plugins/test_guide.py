"""The plugins of the guide, as they stand on its page, inside of a bundle: string, loss law, effect, pickup."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.support.yaml_io import load_yaml

PAGE = Path(__file__).parents[2] / "docs" / "write_a_plugin.md"
FS = 24000


def lyre(folder: Path, room: float, **strings: Any) -> tw.Instrument:
    """The monochord with a pin and a pickup of the guide, and other keys of its string."""
    target = folder / "lyre"
    shutil.copytree(tw.list_instruments()["monochord"], target, dirs_exist_ok=True)
    text = "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))
    (target / "guide.py").write_text(text.partition("import shutil")[0])
    values: Any = load_yaml(target / "instrument.yaml", error=BundleError)
    values["strings"]["A2"] |= strings
    values["connections"] = {"pin": {"plugin": "guide.py:Pin", "from_bridge": 0.3, "room": room}}
    values["outputs"] = [{"name": "pair", "plugin": "guide.py:Pair", "at": "A2.pluck", "full_scale": 2.0}]
    return tw.Instrument.from_values(values, target, allow_code=True)


def played(instrument: tw.Instrument, force: float, mode: str | list[str]) -> NDArray[np.float64]:
    score = tw.Score([tw.Note(0.02, 1.0, string="A2", stop=0, force=force, angle_deg=20.0)])
    return tw.render(score, instrument.replace({"effects.mode": mode}), fs=FS, max_duration=0.6).samples


def test_the_pin_is_reached_by_loud_notes_alone(tmp_path: Path) -> None:
    """Switched on and off it is the same as always on, and nothing is added where the string does not reach it."""
    instrument = lyre(tmp_path, room=5e-4)
    for force, reached in ((0.05, False), (2.0, True)):
        modes: dict[str, Any] = {"auto": "auto", "all": "all", "without": ["second_polarization", "dampers"]}
        sounds = {name: played(instrument, force, mode) for name, mode in modes.items()}
        peak = np.abs(sounds["all"]).max()
        assert np.abs(sounds["auto"] - sounds["all"]).max() < 1e-9 * peak
        assert (np.abs(sounds["all"] - sounds["without"]).max() > 1e-3 * peak) == reached


def test_the_pickup_hears_both_planes_and_names_its_points(tmp_path: Path) -> None:
    samples = played(lyre(tmp_path, room=5e-3), 1.0, "all")
    up, sideways = np.abs(samples).max(axis=0)
    assert sideways / up == pytest.approx(np.tan(np.deg2rad(20.0)), rel=0.1)
    with pytest.raises(BundleError, match=r"outputs\.pair\.at: is none of A2\.bridge, A2\.pluck"):
        played(lyre(tmp_path, room=5e-3).replace({"outputs.pair.at": "A2.middle"}), 1.0, "all")


def test_string_and_law_of_the_guide_decay_alike(tmp_path: Path) -> None:
    """A law of power 0 is one decay time for all partials, as the string states it."""
    keys = ("plugin", "note", "end", "polarizations", "length", "tension", "linear_density")
    old = load_yaml(tw.list_instruments()["monochord"] / "instrument.yaml", error=BundleError)["strings"]["A2"]
    same = {k: v for k, v in old.items() if k in keys}
    by_law = lyre(tmp_path, 5e-3, bending_stiffness=0.0, loss={"law": "guide.py:Power", "sigma": 3.0, "power": 0.0})
    values: Any = {
        **by_law.resolved,
        "strings": {"A2": {**same, "plugin": "guide.py:EvenString", "t60": np.log(1e3) / 3}},
    }
    by_string = tw.Instrument.from_values(values, by_law.folder, allow_code=True)
    one, two = (instrument.resonators["A2"].basis(4000.0) for instrument in (by_law, by_string))
    np.testing.assert_allclose(one.poles, two.poles, rtol=1e-12)
