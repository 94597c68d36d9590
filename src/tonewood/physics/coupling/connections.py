"""Connections between components, their laws, and the linear solve for their forces.

A connection acts on a gap g = sum_i a_i y_i over points of components and pulls on every one of them with a_i f, so
that its power is f g'. Over a step of length h each linear law reads

    S f + g+ + gamma g = (1 + gamma) b,

    rigid                              S = 0,                gamma = 0
    rigid, residual compliance R       S = 2 A R A^T,        gamma = 1       (f = -(Z + 2R)^+ (g_u + g))
    spring k and dashpot r             S = 1/alpha,          gamma = beta/alpha,   alpha, beta = k/2 +- r/h

The residual compliance R of the springs' gaps acts in series, f = -(K + r s) (g + R f). To first order in s, and for
gaps that move alike, this is a law of g alone with k u and r u^2, where (I + R K) u = 1; for one spring
u = 1 / (1 + k R). R between springs and rigid connections is left out.

With g+ = g_u + Z f, Z = A (port compliance over one step) A^T, the corrective force of Udwadia and Kalaba is
f = -(Z + S)^+ (g_u + gamma g - (1 + gamma) b); ^+ is the pseudo-inverse, so redundant constraints are legal.
For passive components no law here can create energy, whatever the step, stiffness or force: the work of f over a
step is f (g+ - g), which is 0, minus a growth of the residual's potential, or minus spring energy and loss.

Nonlinear laws (`laws`) act on their gaps with these eliminated: g_n+ = g_n,u + Z_nl f_l0 + Z~ f_n with
Z~ = Z_nn - Z_nl G Z_ln. The residual compliance R of their gaps acts in series, as displacements rho that the laws see
besides g,

    theta rho+ + (1 - theta) rho = R f,      Z~ -> Z~ + R / theta,

with the stored energy rho R^-1 rho / 2, and loses (2 theta - 1) / 2 of (rho+ - rho) R^-1 (rho+ - rho). With
theta = 1/2, as for rigid connections, rho would change its sign for ever after a contact has opened. With
theta = 1 / (1 + exp(-s h)) it does so under exp(-s t), whatever the step h, and the loss is of the order of h^2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.inverse import DenseInverse, InverseInParts, scaled_pinv
from tonewood.physics.coupling.laws import NonlinearLaw
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class Term:
    """Share of one point in a gap or in a readout: `factor` times the motion of ``component.point``.

    Attributes
    ----------
    component, point : names.
    factor : share of the point's motion, counted along the direction of the component or of the body's point.
    """

    component: str
    point: str
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class Rigid:
    """Holds the gap at `offset` (m); gives way only by the residual compliance of the components."""

    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class SpringDashpot:
    """Spring and dashpot, f = -stiffness (g - offset) - damping g'; the residual compliance of its gap is in series.

    Over a step f = -stiffness ((g+ + g)/2 - offset) - damping (g+ - g)/h: of second order, passive at any h.

    Attributes
    ----------
    stiffness : N/m.
    damping : N s/m.
    offset : gap without force, m.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (self.stiffness >= 0.0 and self.damping >= 0.0):
            raise ValueError("stiffness and damping of a connection must not be negative")

    def softened(self, share: float) -> SpringDashpot:
        """Return the law of a gap of which the spring and the dashpot see a share, with their energy and loss."""
        return replace(self, stiffness=self.stiffness * share, damping=self.damping * share**2)


Law = Rigid | SpringDashpot | NonlinearLaw

#: 1/s, rate at which the residual compliance in series with a nonlinear law forgets, once nothing pushes on it
FORGETTING = 4e3


#: purpose of a connection in an instrument: the joint of a string's end to the body, the dashpot of the finger that
#: holds a string while it is plucked, something that an attachment or exciter adds to a string, or something added to
#: the body; empty outside of instruments
Role = Literal["", "bridge", "hold", "attached", "added"]


@dataclass(frozen=True, slots=True)
class Connection:
    """A law acting on a gap: g = sum factor y(point), and the force f of the law acts as factor f on each point.

    Attributes
    ----------
    name : unique in its system.
    terms : shares of points in the gap.
    law : of the force.
    role : its purpose; set by the assembly of an instrument, like the next two.
    owner : string that it belongs to.
    part : key of the attachment or exciter that adds it; empty for the other roles.
    """

    name: str
    terms: tuple[Term, ...]
    law: Law = Rigid()
    role: Role = ""
    owner: str = ""
    part: str = ""


@dataclass(frozen=True, eq=False)
class LinearSolve:
    """f = rhs - G g_u - G gamma g over all m connections of a system; G acts among the k that can carry force.

    on : (k,) their places.
    by : G among them: the inverse of S + Z.
    gamma : (m,) share of the old gap.
    offset : (m,) (1 + gamma) b, m.
    """

    on: NDArray[np.intp]
    by: DenseInverse | InverseInParts
    gamma: Floats
    offset: Floats

    @property
    def inverse(self) -> Floats:
        """(k, k) N/m, G among these."""
        return self.by.dense

    @cached_property
    def G(self) -> Floats:
        """(m, m) N/m."""
        out = np.zeros((self.gamma.size, self.gamma.size))
        out[self.on[:, None], self.on] = self.inverse
        return out

    def apply(self, gaps: Floats) -> Floats:
        """G times (m,) or (m, columns)."""
        if isinstance(self.by, DenseInverse):
            return np.asarray(self.G @ gaps)
        out = np.zeros_like(gaps)
        out[self.on] = self.by.apply(gaps[self.on])
        return out

    @cached_property
    def constant(self) -> Floats:
        """(m,) N, force from the offsets alone."""
        return self.apply(self.offset)


@dataclass(frozen=True, eq=False)
class LinearLaws:
    """Numbers of m laws that do not depend on the components.

    rigid, active : (m,) which laws are rigid, and which carry a force here: rigid ones, springs and dashpots.
    softness, gamma : (m,) 1/alpha (m/N) and beta/alpha of springs and dashpots, 0 for others.
    offset : (m,) m.
    """

    rigid: NDArray[np.bool_]
    active: NDArray[np.bool_]
    softness: Floats
    gamma: Floats
    offset: Floats

    @classmethod
    def of(cls, laws: Sequence[Law], dt: float) -> LinearLaws:
        """Take the numbers of laws for a step of dt (s)."""
        off, none = np.zeros(len(laws), dtype=bool), np.zeros(len(laws))
        return cls(off, off, none, none, none).changed(dict(enumerate(laws)), dt)

    def changed(self, laws: Mapping[int, Law], dt: float) -> LinearLaws:
        """Return these laws with others at some places; itself if their numbers are the same (other nonlinear laws)."""
        numbers = {j: _numbers(law, dt) for j, law in laws.items()}
        if all(self._at(j) == now for j, now in numbers.items()):
            return self
        new = LinearLaws(
            self.rigid.copy(), self.active.copy(), self.softness.copy(), self.gamma.copy(), self.offset.copy()
        )
        for j, now in numbers.items():
            new.rigid[j], new.active[j], new.softness[j], new.gamma[j], new.offset[j] = now
        return new

    def _at(self, j: int) -> tuple[bool, bool, float, float, float]:
        numbers = self.rigid[j], self.active[j], self.softness[j], self.gamma[j], self.offset[j]
        return bool(numbers[0]), bool(numbers[1]), float(numbers[2]), float(numbers[3]), float(numbers[4])

    def solve(self, compliance: Floats, residual: Floats) -> LinearSolve:
        """Eliminate the forces: `compliance` Z and `residual` R are (m, m) m/N of the gaps, Z over one step.

        The pseudo-inverse is taken of the matrix scaled to unit diagonal, so that rank is judged alike for light and
        heavy parts. Of redundant constraints the motion is unique; their shares of the force are least squares in that
        scaling. A connection without stiffness and damping carries no force.
        """
        entries, twice_rigid, softness = self._among
        matrix = compliance.take(entries) + (twice_rigid * residual.take(entries) + softness)
        return self.solved(DenseInverse(scaled_pinv(matrix)), compliance.diagonal(), residual.diagonal())

    def solved(self, by: DenseInverse | InverseInParts, compliance: Floats, residual: Floats) -> LinearSolve:
        """Return the solve by an inverse; (m,) m/N of the gaps tell which rigid connections give way."""
        yielding = self.rigid & (residual > 1e-14 * np.maximum(compliance, 0.0))
        gamma = np.where(yielding, 1.0, self.gamma)
        return LinearSolve(self.on, by, gamma, (1 + gamma) * self.offset)

    @cached_property
    def on(self) -> NDArray[np.intp]:
        """(k,) connections that can carry force."""
        return np.flatnonzero(self.active)

    @cached_property
    def _among(self) -> tuple[NDArray[np.intp], Floats, Floats]:
        """(k, k) among these: places in a flat (m, m) matrix, 2 between rigid ones, and 1/alpha on the diagonal."""
        rigid = self.rigid[self.on].astype(np.float64)
        entries = self.on[:, None] * self.active.size + self.on
        return entries, 2 * rigid[:, None] * rigid, np.diag(self.softness[self.on])


@dataclass(frozen=True, eq=False)
class NonlinearLaws:
    """The k laws that are neither rigid nor springs and dashpots.

    index : (k,) their places among the m connections.
    laws : (k,).
    theta : of R in series.
    """

    index: NDArray[np.intp]
    laws: tuple[NonlinearLaw, ...]
    theta: float

    @classmethod
    def of(cls, laws: Sequence[Law], dt: float) -> NonlinearLaws:
        """Take them out of all laws, for a step of dt (s)."""
        chosen = [(j, law) for j, law in enumerate(laws) if not isinstance(law, (Rigid, SpringDashpot))]
        index = np.array([j for j, _ in chosen], dtype=np.intp)
        return cls(index, tuple(law for _, law in chosen), 1 / (1 + math.exp(-FORGETTING * dt)))

    @cached_property
    def is_contact(self) -> NDArray[np.bool_]:
        """(k,) which of them push one way only, from a clearance on."""
        return np.array([law.one_sided for law in self.laws], dtype=bool)

    def changed(self, laws: Mapping[int, Law], dt: float) -> NonlinearLaws:
        """Return these laws with others at some places; itself if no nonlinear law is concerned."""
        by_index = dict(zip(self.index.tolist(), self.laws, strict=True))
        if not any(j in by_index or not isinstance(law, (Rigid, SpringDashpot)) for j, law in laws.items()):
            return self
        merged: dict[int, Law] = {**by_index, **laws}
        chosen = {j: law for j, law in sorted(merged.items()) if not isinstance(law, (Rigid, SpringDashpot))}
        return NonlinearLaws(np.array(list(chosen), dtype=np.intp), tuple(chosen.values()), self.theta)


@dataclass(frozen=True, eq=False)
class NonlinearGaps:
    """Compliance at the gaps of nonlinear laws while the linear connections carry no force.

    Residual compliance between a nonlinear and a linear gap is left out: the rest is positive semi-definite.

    laws : k of them.
    compliance : (k, k) m/N, Z_nn with the series part R / theta.
    from_linear : (k, m) m/N, Z_nl: gaps per force of the linear connections.
    to_linear : (m, k) m/N, Z_ln: gaps of the linear connections per force of these.
    residual : (k, k) m/N, R of the gaps whose laws have it; zero elsewhere.
    """

    laws: NonlinearLaws
    compliance: Floats
    from_linear: Floats
    to_linear: Floats
    residual: Floats

    @classmethod
    def of(cls, laws: NonlinearLaws, compliance: Floats, residual: Floats) -> NonlinearGaps:
        """Select them from the compliance of all gaps; shapes as in `LinearLaws.solve`."""
        on, among = laws.index, np.ix_(laws.index, laws.index)
        yields = np.array([law.residual for law in laws.laws], dtype=bool)
        R = residual[among] * np.outer(yields, yields)
        return cls(laws, compliance[among] + R / laws.theta, compliance[on], compliance[:, on], R)


class NonlinearSolve:
    """The k nonlinear connections of a system after the linear ones are eliminated; immutable.

    gaps : compliance of the nonlinear gaps without the linear connections; `from_linear` and `residual` are its.
    linear : elimination of the linear connections.
    index, laws, theta : of `NonlinearLaws`.
    """

    def __init__(self, gaps: NonlinearGaps, linear: LinearSolve):
        self.gaps, self.linear = gaps, linear
        self.index, self.laws, self.theta = gaps.laws.index, gaps.laws.laws, gaps.laws.theta
        self.from_linear, self.residual = gaps.from_linear, gaps.residual

    @cached_property
    def answer(self) -> Floats:
        """(m, k) G Z_ln: linear forces are -answer @ (nonlinear forces) besides."""
        # most connections are no linear ones: only those have a force to answer with
        on, out = self.linear.on, np.zeros_like(self.gaps.to_linear)
        out[on] = self.linear.by.apply(self.gaps.to_linear[on])
        return out

    @cached_property
    def Z(self) -> Floats:
        """(k, k) m/N, Z~ with the series part R / theta."""
        on = self.linear.on
        Z = self.gaps.compliance - self.gaps.from_linear[:, on] @ self.answer[on]
        return np.asarray(0.5 * (Z + Z.T))

    def carried_series(self, series: Floats) -> Floats:
        """(m,) displacements in series as this system goes on with those of the one before it.

        A connection that no longer yields (a finger that left, a fret behind the stop) has none. A new one shares the
        displacement of the others at its place, R_jq R_qq^+ rho_q, which leaves the energy as it is: laws at one place
        yield alike.
        """
        rho, R = series[self.index], self.residual
        rho[np.diag(R) <= 0.0] = 0.0
        moved = rho != 0.0
        come = ~moved & np.any(R[:, moved] != 0.0, axis=1)
        if come.any():
            rho[come] = R[np.ix_(come, moved)] @ scaled_pinv(R[np.ix_(moved, moved)]) @ rho[moved]
        out = np.zeros_like(series)
        out[self.index] = rho
        return out


def _numbers(law: Law, dt: float) -> tuple[bool, bool, float, float, float]:
    """One law as `LinearLaws` has it."""
    if isinstance(law, Rigid):
        return True, True, 0.0, 0.0, law.offset
    if not isinstance(law, SpringDashpot):
        return False, False, 0.0, 0.0, 0.0
    alpha, beta = law.stiffness / 2 + law.damping / dt, law.stiffness / 2 - law.damping / dt
    return False, alpha > 0, *((1 / alpha, beta / alpha) if alpha > 0 else (0.0, 0.0)), law.offset
