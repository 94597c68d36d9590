"""The contract's door for potentials: a body of a bundle's own that hardens, its effect, and its mistakes."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.instrument.inspection.potentials_at_rest import small_motions
from tonewood.instrument.model.assembly import assemble

SOURCE = '''
import numpy as np
import tonewood.authoring as ta

HARD = ta.Effect("hardening", "a body that hardens", "detuning", "always", "nothing")


class BlockParameters(ta.Parameters):
    """Of the block."""

    hardness: float = ta.quantity("N/m^3", low=0.0, high=1e20, doc="of its third power")


class Cube(ta.PotentialEnergy):
    sizes = (1,)

    def __init__(self, k):
        self.k = k

    def gradient(self, y):
        return float(0.25 * self.k * y[0] ** 4), self.k * y**3


class Block(ta.Body[BlockParameters]):
    api = 1
    Parameters = BlockParameters
    effects = (*ta.Body.effects, HARD)

    def points(self):
        return {"top": ta.BodyPoint((0.0, 0.0, 1.0))}

    def basis(self, freq_upper):
        return ta.ModalBasis.real([900.0], [20.0], {"top": [1.0]}, modal_mass=0.02)

    def potentials(self, component):
        return [ta.ModalPotential("block", (component,), lambda bases: Cube(self.parameters.hardness), "hardening")]
'''


def block(folder: Path, hardness: float) -> tw.Instrument:
    """The monochord on a block that hardens."""
    shutil.copytree(tw.list_instruments()["monochord"], folder)
    values = yaml.safe_load((folder / "instrument.yaml").read_text(encoding="utf-8"))
    values["body"] = {"plugin": "block.py:Block", "hardness": hardness}
    name = next(n for n in values["strings"] if n != "defaults")
    for part in values["strings"].values():
        part.pop("end", None)
    values["strings"][name]["end"] = "body.top"
    values["outputs"] = [{"name": "top", "plugin": "point_pickup", "quantity": "acceleration", "at": "body.top",
                          "full_scale": 1500.0}]  # fmt: skip
    (folder / "instrument.yaml").write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    (folder / "block.py").write_text(SOURCE, encoding="utf-8")
    return tw.load_instrument(folder, allow_code=True)


SCORE = tw.Score([tw.Note(0.0, 0.2, note=45, force=8.0)])


def test_a_body_hardens_and_its_energy_adds_up(tmp_path: Path) -> None:
    hard = block(tmp_path / "hard", 1e15)
    sound = tw.render(SCORE, hard, 8000, oversampling=1.0, max_duration=0.1, effects="all", energy=True)
    assert sound.energy is not None
    assert sound.energy.worst_residual < 1e-11
    assert sound.energy.stored["block.potential"].max() > 0.0
    plain = tw.render(SCORE, hard, 8000, oversampling=1.0, max_duration=0.1, effects="none").samples
    assert np.abs(sound.samples - plain).max() > 1e-3 * np.abs(plain).max()


def test_its_effect_leaves_it_out(tmp_path: Path) -> None:
    hard = block(tmp_path / "hard", 1e15)
    soft = block(tmp_path / "soft", 0.0)
    assert [p.name for p in assemble(hard, 8000.0).system.potentials] == ["block"]
    for mode, count in (("all", 1), ("none", 0), (["hardening"], 1)):
        assert len(assemble(hard.replace({"effects.mode": mode}), 8000.0).system.potentials) == count
    ways = (hard, ["second_polarization", "dampers"]), (soft, ["second_polarization", "dampers", "hardening"])
    left_out, linear = (
        tw.render(SCORE, made, 8000, effects=effects, oversampling=1.0, max_duration=0.05).samples
        for made, effects in ways
    )
    np.testing.assert_allclose(left_out, linear, atol=1e-9 * np.abs(linear).max())


def test_a_gradient_that_fails_ends_in_one_line(tmp_path: Path) -> None:
    folder = tmp_path / "hard"
    block(folder, 1e15)
    source = (folder / "block.py").read_text(encoding="utf-8").replace("sizes = (1,)", "sizes = (2,)")
    (folder / "block.py").write_text(source, encoding="utf-8")
    with pytest.raises(TonewoodError, match="modes, not 2 coordinates"):
        tw.render(SCORE, tw.load_instrument(folder, allow_code=True), 8000, max_duration=0.02, effects="all")


WORKS = "return float(0.25 * self.k * y[0] ** 4), self.k * y**3"
LATE = """self.calls = getattr(self, "calls", 0) + 1
        if self.calls > 200:
            raise {}
        """


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        (LATE.format('RuntimeError("one\\ntwo")') + WORKS, "Cube.gradient raises RuntimeError: one two"),
        (LATE.format("SystemExit(0)") + WORKS, "Cube.gradient raises SystemExit: 0"),
        ("return 1.0, np.zeros(3)", r"dV/dy has shape \(3,\), not \(1,\)"),
        ("return 1.0, 0.0", r"dV/dy has shape \(\), not \(1,\)"),
        ("return None", "Cube.gradient raises TypeError"),
        ("return 1.0, 1j * y", "Cube.gradient raises TypeError"),
        ('return 1.0, y if y[0] == 0.0 else ["a"]', "Cube.gradient raises"),
        ('return float("nan"), y', "not finite at rest"),
        ("return y[0] ** 2 - 5.0, 2 * y", "V = -5 J at rest is below `least` = 0 J"),
        # unbounded, but not at rest
        ("return float(-0.25e10 * y[0] ** 4), -1e10 * y**3", r"Cube: V = -\S+ J is below `least` = 0 J in the motion"),
        ("return float(1e10 * y[0] ** 3), 3e10 * y**2", r"Cube: V = -\S+ J is below `least` = 0 J in the motion"),
    ],
)
@pytest.mark.parametrize("account", [False, True])
def test_a_wrong_gradient_ends_in_one_line_whenever_it_goes_wrong(
    tmp_path: Path, wrong: str, line: str, account: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "hard"
    block(folder, 1e15)
    source = (folder / "block.py").read_text(encoding="utf-8")
    assert WORKS in source
    (folder / "block.py").write_text(source.replace(WORKS, wrong), encoding="utf-8")
    instrument = tw.load_instrument(folder, allow_code=True)
    with pytest.raises(TonewoodError, match=line) as caught:
        tw.render(SCORE, instrument, 8000, oversampling=1.0, max_duration=0.1, effects="all", energy=account)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gradient", "freq", "words"),
    [
        ("float(0.25 * self.k * y[0] ** 4), self.k * y**3", 900.0, None),
        # of omega^2 + k with k = omega^2
        ("float(0.5 * self.k * y[0] ** 2), self.k * y", 900.0 * 2**0.5, r"sounds at 202.571 Hz \(\+600.0 cents\)"),
        ("float(-0.5 * self.k * y[0] ** 2 + y[0] ** 4), -self.k * y + 4 * y**3", 0.0, "is unstable"),
        ("float(0.25 * (y[0] + 1.0) ** 4), (y + 1.0) ** 3", np.sqrt(900.0**2 + 3.0), "pushes at rest"),
    ],
    ids=["fourth power", "spring", "falling", "push"],
)
def test_check_measures_a_potential_near_rest(
    tmp_path: Path, gradient: str, freq: float, words: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    block(tmp_path / "hard", 900.0**2 if words != "is unstable" else 1e7)
    bounds = "\n    least, scale = -1e20, 1.0" if words == "is unstable" else ""
    source = SOURCE.replace("float(0.25 * self.k * y[0] ** 4), self.k * y**3", gradient)
    source = source.replace("    sizes = (1,)", f"    sizes = (1,){bounds}")
    (tmp_path / "hard" / "block.py").write_text(source, encoding="utf-8")
    motion = small_motions(assemble(tw.load_instrument(tmp_path / "hard", allow_code=True), 8000.0))[0]
    assert motion.freq == pytest.approx(freq / (2 * np.pi), rel=1e-9)
    assert (motion.doubt is None) == (words is None)
    if words:
        assert motion.doubt is not None
        assert re.search(words, motion.doubt)
    if words != "is unstable":
        with pytest.raises(SystemExit) as end:
            run(["check", str(tmp_path / "hard"), "--allow-code", "--fs", "8000"])
        assert end.value.code == 0
        printed = capsys.readouterr().out
        assert (motion.doubt is None) == ("block: " not in printed)
        assert motion.doubt is None or f"warning: {motion.doubt}" in printed


@pytest.mark.parametrize(
    ("changed", "ratio"),
    [
        (WORKS, None),
        (WORKS.replace("self.k * y**3", "-self.k * y**3"), -1.0),
        (WORKS.replace("self.k * y**3", "0.99 * self.k * y**3"), 0.99),
        (WORKS + "\n\n    def energy(self, y):\n        return float(0.5 * self.k * y[0] ** 4)", 0.5),
    ],
    ids=["right", "sign", "1 %", "another energy"],
)
def test_check_compares_the_gradient_with_differences_of_v(tmp_path: Path, changed: str, ratio: float | None) -> None:
    """A render with a wrong gradient ends well: the step balances the energies with any."""
    block(tmp_path / "hard", 1e15)
    (tmp_path / "hard" / "block.py").write_text(SOURCE.replace(WORKS, changed), encoding="utf-8")
    motion = small_motions(assemble(tw.load_instrument(tmp_path / "hard", allow_code=True), 8000.0))[0]
    if ratio is None:
        assert motion.wrong is None
        assert motion.doubt is None
        return
    assert motion.wrong is not None
    coordinate, slope, difference = motion.wrong
    assert coordinate == 0
    assert slope / difference == pytest.approx(ratio, rel=1e-6)
    assert motion.doubt is not None
    assert motion.doubt.startswith("block: its gradient is not that of its V: dV/dy of coordinate 0 is ")
