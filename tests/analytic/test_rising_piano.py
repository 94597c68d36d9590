"""Keys of the grand piano whose tension rises, or that move lengthwise both ways: in parts, in one matrix; energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from pianos import piano
from tonewood.physics.coupling import elimination
from tonewood.physics.coupling.inverse import InverseInParts
from tonewood.sound.render.renderer import Renderer

#: kind of string -> cells of the table of keys; its own leverage is that of `phantom_string`
KINDS = {
    "tension_modulated_string": {"string.bridge_leverage": ""},
    "geometric_string": {"string.bridge_leverage": "0.02"},
}
SCORE = tw.Score(
    [tw.Note(0.004 * i, 0.012, note=n, velocity_midi=110) for i, n in enumerate((45, 48, 52))],
    [tw.Control(0.01, "cc64", 1.0)],
)


def rendered(kind: str, folder: Path) -> Renderer:
    cells = {"string.plugin": kind, "string.freq_upper": "4000", "string.axial_stiffness": "1.8e5"} | KINDS[kind]
    keys = piano(folder, ["A2", "C3", "E3"], cells)
    return Renderer(SCORE, keys, 48000.0, max_duration=0.03, effects="all", energy=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tension_modulated_string", "geometric_string"])
def test_hammers_meet_rising_tensions_in_parts_as_in_one_matrix(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for least in (8, 10**6):
        monkeypatch.setattr(elimination, "LEAST_IN_PARTS", least)
        stream = rendered(kind, tmp_path / str(least))
        system = stream.engine.system
        assert any(system.potentials.on)
        assert isinstance(system.solve.by, InverseInParts) == (least == 8)
        found.append(np.concatenate([np.asarray(block, dtype=np.float64) for block in stream.blocks()]))
        trace = stream.energy
        assert trace is not None
        put_in = sum(v.sum() for v in trace.supplied.values())
        assert trace.worst_cumulative_residual * trace.peak <= 1e-10 * put_in
    assert np.abs(found[1]).max() > 1e-3
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-9 * np.abs(found[1]).max())
