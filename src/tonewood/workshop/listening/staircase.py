"""Adaptive staircases: levels that fall after right answers and rise after a wrong one.

After `down` right answers in a row the level falls by one step, after a wrong one it rises. It stays near the level
where both are equally likely, P^down = 1/2: 50 %, 70.7 % or 79.4 % right answers for 1, 2, 3. The threshold of a track
is the mean of the levels at its reversals, the first ones left out.

Source: H. Levitt, Transformed up-down methods in psychoacoustics, J. Acoust. Soc. Am. 49 (1971) 467-477, table I.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from tonewood.workshop.batch.pages import StaircasePage


@dataclass
class StaircaseTrack:
    """One track, at the level of its next trial.

    reversal_levels : levels at which the direction changed.
    """

    page: StaircasePage
    level: float = field(init=False)
    levels: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    reversal_levels: list[float] = field(default_factory=list)
    _in_a_row: int = 0
    _direction: int = 0

    def __post_init__(self) -> None:
        self.level = self.page.start

    @property
    def done(self) -> bool:
        """Whether it has its reversals, or cannot get them."""
        return len(self.reversal_levels) >= self.page.reversals or len(self.levels) >= self.page.longest

    @property
    def converged(self) -> bool:
        """Whether it has its reversals."""
        return len(self.reversal_levels) >= self.page.reversals

    @property
    def threshold(self) -> float | None:
        """Mean level of the reversals that count; None for a track that ended without them."""
        counted = self.reversal_levels[self.page.discard : self.page.reversals]
        return self.page.mean(counted) if self.converged else None

    def step_after(self, right: bool) -> float:
        """The level that an answer would lead to."""
        direction = self._move(right)
        if direction == 0:
            return self.level
        reversals = len(self.reversal_levels) + (self._direction not in (0, direction))
        return self.page.moved(self.level, direction, reversals)

    def answer(self, right: bool) -> None:
        """Take the answer to a trial at `level`."""
        self.levels.append(self.level)
        self.right.append(right)
        direction = self._move(right)
        self._in_a_row = 0 if direction else self._in_a_row + 1
        if direction == 0:
            return
        if self._direction not in (0, direction):
            self.reversal_levels.append(self.level)
        self._direction = direction
        self.level = self.page.moved(self.level, direction, len(self.reversal_levels))

    def _move(self, right: bool) -> int:
        if not right:
            return 1
        return -1 if self._in_a_row + 1 >= self.page.down else 0
