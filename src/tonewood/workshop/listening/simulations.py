"""Listeners of a staircase, simulated trial by trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening.detection import chance_of
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.quest import table_of
from tonewood.workshop.listening.staircase import StaircaseTrack
from tonewood.workshop.listening.thresholds import ThresholdGrid


@dataclass(frozen=True)
class Population:
    """Listeners of a staircase: mean threshold, standard deviation of u, slope and spread of ln b, lapse rate."""

    mean: float
    sd: float
    slope: float
    slope_sd: float = 0.3
    lapses: float = 0.02


def trials(
    page: StaircasePage, thresholds: Floats, slopes: Floats, lapses: float, random: np.random.Generator
) -> tuple[list[Floats], list[NDArray[np.bool_]]]:
    """Let listeners take a staircase.

    thresholds : (listeners,) transformed.
    slopes : (listeners,) per unit of u.
    Returns levels : of each listener (trials,), all tracks.
    right : of each listener (trials,).
    """
    guess = chance_of(page)
    if page.adaptive == "quest_plus":
        n = len(thresholds)
        u, table = table_of(page)
        levels, rights = np.empty((n, page.tracks, page.trials)), np.empty((n, page.tracks, page.trials), dtype=bool)
        first = int(np.argmin(np.abs(u - page.transformed(page.start))))
        for k in range(page.tracks):
            posterior, at = np.tile(table.prior, (n, 1)), np.full(n, first)
            for j in range(page.trials):
                p = psychometric(u[at], thresholds, slopes, guess, page.share, lapses)
                right = random.random(n) < p
                levels[:, k, j], rights[:, k, j] = u[at], right
                posterior = table.updated(posterior, at, right)
                at = table.best(posterior)
        back = np.exp(levels) if page.ratio else levels
        return list(back.reshape(n, -1)), list(rights.reshape(n, -1))
    estimates, answers = [], []
    for t, b in zip(thresholds, slopes, strict=True):
        track_levels: list[float] = []
        right_of: list[bool] = []
        for _ in range(page.tracks):
            track = StaircaseTrack(page)
            while not track.done:
                p = float(psychometric(page.transformed(track.level), t, b, guess, page.share, lapses))
                track.answer(bool(random.random() < p))
            track_levels, right_of = track_levels + track.levels, right_of + track.right
        estimates.append(np.array(track_levels))
        answers.append(np.array(right_of))
    return estimates, answers


def likelihoods(
    grid: ThresholdGrid, people: Population, listeners: int, random: np.random.Generator
) -> tuple[Floats, list[int], Floats]:
    """Thresholds (transformed) of listeners who take the grid's staircase, their trials, and tables of likelihoods."""
    page = grid.page
    true = page.transformed(people.mean) + people.sd * random.standard_normal(listeners)
    slopes = people.slope * np.exp(people.slope_sd * random.standard_normal(listeners))
    levels, right = trials(page, true, slopes, people.lapses, random)
    tables = [grid.likelihood(x, r) for x, r in zip(levels, right, strict=True)]
    return true, [len(x) for x in levels], np.array(tables)
