"""Attacks on stability: no energy is made, none is lost from the account, no step is lost."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.lab.accuracy import attacks
from tonewood.lab.accuracy.attacks import Attack
from tonewood.physics.stepping.stepper import Statistics


def hold(attack: Attack) -> None:
    assert attack.failures == 0, attack
    assert attack.growth < 1e-9, attack
    assert not attack.residual > 1e-10, attack


def test_a_rise_is_seen() -> None:
    """Above the lowest value before, as a share of the largest energy, for a million steps."""
    energy = np.array([2.0, 1.0, 1.5, 1.2])
    made = attacks._attack("x", energy, 2.0, Statistics(steps=1000))
    assert made.growth == pytest.approx(0.25 * 1000)


@pytest.mark.slow
def test_short_attacks() -> None:
    for attack in (
        attacks.switched_strings(100),
        attacks.truncated_body(10_000),
        attacks.unequal_masses(1e-9, 10_000),
        attacks.unequal_masses(1e9, 10_000),
        attacks.redundant_joints(10_000),
        attacks.contradictory_joints(10_000),
        attacks.everything_on_one_string(0.1),
    ):
        hold(attack)


@pytest.mark.slow
def test_the_attack_of_the_stop() -> None:
    hold(attacks.stop_at_the_peak(8000))


@pytest.mark.validate
def test_long_attacks() -> None:
    found = attacks.run()
    assert max(a.steps for a in found) >= 10_000_000
    for attack in found:
        hold(attack)
