"""Strings as they are held: kept or derived ones equal those made anew, and are not kept without end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.player.fretting import _CACHE, FrettedBases, Fretting
from tonewood.physics.coupling.system import Compiled
from tonewood.physics.modal.modes import ModalBasis


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(tw.load_instrument("classical_guitar"), 48000.0)


def assert_same(ours: Compiled, anew: Compiled) -> None:
    for name in ("E", "W", "rows", "history", "compliance", "residual"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(anew, name))


def test_open_strings_are_those_of_the_model(model: Model) -> None:
    board = FrettedBases(model)
    for name, string in model.strings.items():
        for c, basis in string.bases().items():
            assert_same(board.bases(name, Fretting())[c], model.system.compile(c, basis))


@pytest.mark.parametrize("fretting", [Fretting(0.0), Fretting(3.0), Fretting(5.0, cents=40.0, place=0.2)])
def test_a_damped_string_is_the_ringing_one_with_other_losses(model: Model, fretting: Fretting) -> None:
    board = FrettedBases(model)
    ringing = model.strings["B3"].bases(fretting.stop, bend_cents=fretting.cents, pluck_from_bridge=fretting.place)
    for c, ours in board.bases("B3", replace(fretting, added_damping=57.5)).items():
        basis = ringing[c]
        shapes = {point: basis.right[i].real for i, point in enumerate(basis.points)}
        slower = ModalBasis.real(np.sqrt(basis.stiffness), basis.damping_rate + 57.5, shapes, residual=basis.residual)
        assert_same(ours, model.system.compile(c, slower))


def test_the_usual_place_of_the_finger_is_no_other_way_to_hold_a_string(model: Model) -> None:
    board, string = FrettedBases(model), model.strings["E4"]
    for stop in (0.0, 12.0):
        usual = min(string.places.pluck, 0.9 * string.length(stop))
        assert board.playable("E4", Fretting(stop, place=usual)) == Fretting(stop)
        assert board.playable("E4", Fretting(stop, place=1.01 * string.length(stop))) == Fretting(stop)
        elsewhere = Fretting(stop, place=0.7 * usual)
        assert board.playable("E4", elsewhere) == elsewhere
        here, same = (board.bases("E4", Fretting(stop, place=p)) for p in (None, usual))
        for c in string.components:
            assert_same(here[c], same[c])


@pytest.mark.slow
def test_bends_without_end_are_not_kept_without_end(model: Model) -> None:
    board = FrettedBases(model)
    bends = [Fretting(1.0, cents=0.5 * i) for i in range(_CACHE + 8)]
    first = board.bases("E4", bends[0])
    for bend in bends:
        board.bases("E4", bend)
    assert len(board._compiled) <= _CACHE
    again = board.bases("E4", bends[0])
    assert again is not first
    for c in first:
        assert_same(again[c], first[c])
