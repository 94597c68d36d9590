"""Dry friction against a moving partner, and its branches over a step.

Friction's curve falls, and a gap that slides under one force of a contact, or one tension of its string, may stick
under the next, and so on for ever. So each friction law keeps to a branch of its curve (`FrictionBranch`) until all
else is found; then `solve_branches` changes a branch that the motion contradicts. At a given velocity the rest of the
step is a monotone problem, with one solution, and the force it asks of friction rises with that velocity; where
friction cannot stick, its curve is met on the way to the velocity without friction. Where changing branches goes on for
too long, halving that interval finds the meeting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

from tonewood.physics.coupling.laws.base import LawArrays, LawKind, NonlinearLaw

Found = TypeVar("Found")

#: changes of each friction law's branch before its velocity is halved for
PATIENCE = 4
#: where on its curve friction is held while all else is found: to be seen, sticking, sliding either way, at a velocity
#: given
Branch = Literal["open", "stuck", "ahead", "behind", "held"]


@dataclass(frozen=True, slots=True)
class Friction(NonlinearLaw):
    """Dry friction against a moving partner, as of a bow: |f| <= static N at rest, mu(v) N sliding.

    mu(v) = dynamic + (static - dynamic) / (1 + |v| / speed) for the velocity v = g' - velocity, f against v
    (Smith & Woodhouse 2000, J. Mech. Phys. Solids 48, their hyperbola). At rest v is exactly 0 over the step.

    The curve falls, so a step may have three solutions. As McIntyre, Schumacher & Woodhouse (1983) take it from
    Friedlander: a gap that stuck goes on sticking while it can; one that slid goes on sliding that way while it can, on
    the outermost (stable) solution; otherwise it sticks if it can. The work f (g+ - g) is f velocity h from the partner
    minus |f v| h of heat.

    Attributes
    ----------
    normal_force : N, pressing the two together.
    static, dynamic : friction coefficients, static >= dynamic >= 0.
    speed : m/s, at which half of their difference is gone.
    velocity : m/s, of the partner along the gap.
    residual : whether the components' residual compliance yields too; unstable with friction on short steps.
    """

    normal_force: float
    static: float = 0.8
    dynamic: float = 0.3
    speed: float = 0.1
    velocity: float = 0.0
    residual: bool = False

    def __post_init__(self) -> None:
        if not (self.normal_force >= 0.0 and self.static >= self.dynamic >= 0.0 and self.speed > 0.0):
            raise ValueError("friction needs static >= dynamic >= 0, a normal force not negative and a speed above 0")

    @property
    def offset(self) -> float:
        """Friction has no place of its own."""
        return 0.0

    def describe(self) -> LawArrays:
        """See `NonlinearLaw`."""
        return LawArrays(LawKind.FRICTION, (self.normal_force, self.static, self.dynamic, self.speed))

    def slide(self, free: float, load: float) -> float | None:
        """Return the largest v > 0 with v + load mu(v) = free, m/s; None if there is none.

        Parameters
        ----------
        free : m/s, velocity without friction.
        load : m/s, velocity that a friction coefficient of 1 takes away.

        Returns
        -------
        The larger root of a quadratic, on the stable branch of the curve.
        """
        a = self.speed
        linear = a + load * self.dynamic - free
        constant = a * (load * self.static - free)
        root = linear * linear - 4 * constant
        if root < 0.0:
            return None
        root = math.sqrt(root)
        v = 0.5 * (root - linear) if linear <= 0.0 else -2 * constant / (linear + root)
        return v if v > 0.0 else None

    def slide_on(self, free: float, load: float) -> float:
        """Return `slide`, or its continuation where there is no such v: continuous in `free` and `load`."""
        v = self.slide(free, load)
        if v is not None:
            return v
        return max(math.sqrt(load * (self.static - self.dynamic) * self.speed) - self.speed, 0.0)

    def velocity_after(self, free: float, load: float, before: float) -> float:
        """Return the relative velocity over the step, m/s, 0 for sticking; see the class for the choice of the branch.

        Parameters
        ----------
        free, load : as for `slide`.
        before : m/s, relative velocity in the last step.
        """
        if before != 0.0:
            side = math.copysign(1.0, before)
            v = self.slide(side * free, load)
            if v is not None:
                return side * v
        if abs(free) <= load * self.static:
            return 0.0
        side = math.copysign(1.0, free)
        v = self.slide(side * free, load)
        return side * v if v is not None else 0.0


@dataclass(eq=False)
class FrictionBranch:
    """A friction law during one step.

    law : of the connection.
    scale : factor on its force.
    slip : m/s, relative velocity in the step before.
    branch : where it is held.
    held : m/s, velocity on the branch "held".
    free, load, velocity, force : results of the last solve: m/s without this force; m/s that a friction coefficient
        of 1 takes; m/s; N.
    """

    law: Friction
    scale: float
    slip: float
    branch: Branch = "open"
    held: float = 0.0
    free: float = 0.0
    load: float = 0.0
    velocity: float = 0.0
    force: float = 0.0

    def meet(self, free: float, mobility: float) -> None:
        """Velocity and force at a velocity without friction (m/s), and m/s that a newton makes."""
        self.free, self.load = free, mobility * self.law.normal_force * self.scale
        match self.branch:
            case "open":
                self.velocity = self.law.velocity_after(free, self.load, self.slip)
                self.branch = "ahead" if self.velocity > 0 else "behind" if self.velocity < 0 else "stuck"
            case "stuck":
                self.velocity = 0.0
            case "ahead":
                self.velocity = self.law.slide_on(free, self.load)
            case "behind":
                self.velocity = -self.law.slide_on(-free, self.load)
            case "held":
                self.velocity = self.held
        self.force = (self.velocity - free) / mobility if mobility > 0 else 0.0

    def follows(self) -> float:
        """Derivative of the velocity with that without friction."""
        if self.branch not in ("ahead", "behind") or self.velocity == 0.0:
            return 0.0
        v, law = abs(self.velocity), self.law
        if law.slide(abs(self.free) if self.free * self.velocity > 0 else -abs(self.free), self.load) is None:
            return 0.0
        falls = self.load * (law.static - law.dynamic) * law.speed / (law.speed + v) ** 2
        return 1.0 / (1.0 - falls) if falls < 1.0 else 0.0

    def changes(self) -> bool:
        """Goes over to the branch that is its own under the motion found; False if it is there."""
        may_stick = abs(self.free) <= self.load * self.law.static
        if self.branch == "held" or (self.branch == "stuck" and may_stick):
            return False
        side = 1.0 if self.branch == "ahead" else -1.0
        if self.branch != "stuck" and self.law.slide(side * self.free, self.load) is not None:
            return False
        before = self.branch
        self.branch = "stuck" if may_stick else "ahead" if self.free > 0 else "behind"
        return self.branch != before


def solve_branches(branches: Sequence[FrictionBranch], solve: Callable[[], Found]) -> Found:
    """Call `solve`, which finds all else with friction on its branches, until each is on its own; see the module.

    Raises ValueError : they are not found.
    """
    for iteration in range((PATIENCE + 1) * len(branches) + 1):
        solution = solve()
        changed = next((friction for friction in branches if friction.changes()), None)
        if changed is None:
            return solution
        if iteration >= PATIENCE * len(branches):
            _halve(changed, solve)
    raise ValueError("friction finds no branch")


def _halve(friction: FrictionBranch, solve: Callable[[], object]) -> None:
    """Hold friction at the velocity where its curve meets the force that the rest of the step asks for."""
    law, pressed = friction.law, friction.law.normal_force * friction.scale

    def hold(v: float) -> None:
        friction.branch, friction.held = "held", v
        solve()

    hold(0.0)
    if abs(friction.force) <= pressed * law.static:
        return
    side = 1.0 if friction.force < 0 else -1.0
    low, high, bracketed = 0.0, abs(friction.free), False
    for _ in range(200):
        v = 0.5 * (low + high) if bracketed else high
        if v == low or (bracketed and v == high):
            break
        hold(side * v)
        coefficient = law.dynamic + (law.static - law.dynamic) / (1 + v / law.speed)
        if side * friction.force + pressed * coefficient < 0:
            low, high = v, high if bracketed else 2 * v
        else:
            high, bracketed = v, True
    if not bracketed:
        raise ValueError("friction finds no branch")
