"""Inverse of the compliance that linear connections see: dense, or in parts that one component joins.

Of m connections, M = Z + S is the motion of their gaps per force (`connections`). Without the component on which most
of them meet, the hub (an instrument's body), M falls into small diagonal blocks D: strings touch each other nowhere
else. The hub moves by r motions, which reach the gaps by U (m, r) and answer forces by C (r, r):

    M = D + U C U^T,      M^-1 = B - B U K U^T B,      B = D^-1,   H = U^T B U,   K = (I + C H)^-1 C

(Woodbury). Unison strings share a point of the hub, U = Q P: Q (m, p) has one number a row, P (p, r) is the motion of
p points. A product with M^-1 then takes m + 2 p r + 3 r^2 multiplications in place of m^2, and a connection that the
hub does not feel costs one. Where the hub's residual compliance R would join the parts, its motions are those of all
its points, and C + 2 R takes the place of C. It is the same number to rounding if D is far from singular and C H is not
large.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tonewood.support.arrays import Floats, Indices

#: (e,) rows, columns and values of a sparse matrix; those of one entry add up
Entries = tuple[Indices, Indices, Floats]

#: connections of one part at most
MOST_IN_PART = 12
#: norm of I + C H at most: the forces lose as many digits
LARGEST_NORM = 1e4


def scaled_pinv(matrix: Floats, rtol: float = 1e-12) -> Floats:
    """Pseudo-inverse of a square matrix after scaling it to unit diagonal (zero rows stay zero)."""
    if not matrix.size:
        return matrix
    diagonal = np.abs(matrix.diagonal())
    moves = diagonal > 0
    d = moves / np.sqrt(np.where(moves, diagonal, 1.0))
    scale = d[:, None] * d
    scaled = matrix * scale
    inverse = _inverse(scaled)
    if inverse is None:
        inverse = np.asarray(np.linalg.pinv(scaled, rtol=rtol), dtype=np.float64)
    return np.asarray(inverse * scale)


def _inverse(matrix: Floats) -> Floats | None:
    """Inverse by LU, several times quicker than the singular values; None unless the matrix is far from singular."""
    try:
        inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    condition = np.abs(matrix).sum(axis=0).max() * np.abs(inverse).sum(axis=0).max()  # in the 1-norm
    return inverse if condition < 1e8 else None


@dataclass(frozen=True, eq=False)
class Hub:
    """The component on which most connections meet.

    slot : of the component.
    ports : (r,) its ports whose displacements are the motions.
    point : (k,) point of it in each connection, -1 for connections that it is no part of.
    factor : (k,) share of that point's displacement in the gap.
    span : (p, r) displacement of each point per motion, P.
    compliance : (r, r) m/N, C.
    """

    slot: int
    ports: Indices
    point: Indices
    factor: Floats
    span: Floats
    compliance: Floats

    @cached_property
    def gaps(self) -> Floats:
        """(k, r) U."""
        return np.asarray(np.where(self.point[:, None] >= 0, self.factor[:, None] * self.span[self.point], 0.0))


@dataclass(frozen=True, eq=False)
class DenseInverse:
    """The inverse as one matrix.

    dense : (k, k) N/m.
    """

    dense: Floats

    def apply(self, x: Floats) -> Floats:
        """Multiply (k,) or (k, columns)."""
        return np.asarray(self.dense @ x)


@dataclass(frozen=True, eq=False)
class InverseInParts:
    """The inverse as small blocks and the motions of a hub.

    parts : (b, n) indices among the k connections, and (b, n, n) N/m inverses, of parts of n connections each.
    hub : None if no connection needs it.
    """

    parts: tuple[tuple[Indices, Floats], ...]
    hub: Hub | None

    @classmethod
    def of(cls, k: int, entries: Entries, hub: Hub | None) -> InverseInParts | None:
        """Invert `entries`, compliance of k connections without the hub; None where the dense inverse is wanted."""
        parts = _parts(k, entries)
        if parts is None:
            return None
        new = cls(parts, hub)
        return new if hub is None or np.abs(new._loop).sum(axis=0).max(initial=0.0) < LARGEST_NORM else None

    def blocks(self, x: Floats) -> Floats:
        """B x."""
        out = np.zeros_like(x)
        for places, inverses in self.parts:
            out[places] = np.einsum("bij,bj...->bi...", inverses, x[places])
        return out

    @cached_property
    def _stiffness(self) -> Floats:
        """(r, r) N/m, H."""
        assert self.hub is not None
        return np.asarray(self.hub.gaps.T @ self.blocks(self.hub.gaps))

    @cached_property
    def _loop(self) -> Floats:
        """(r, r) I + C H."""
        assert self.hub is not None
        return np.asarray(np.eye(len(self.hub.compliance)) + self.hub.compliance @ self._stiffness)

    @cached_property
    def joined(self) -> Floats:
        """(r, r) m/N, K: how the motions answer with the other components on the hub."""
        assert self.hub is not None
        return np.asarray(np.linalg.solve(self._loop, self.hub.compliance))

    def apply(self, x: Floats) -> Floats:
        """Multiply (k,) or (k, columns)."""
        y = self.blocks(x)
        if self.hub is None:
            return y
        U = self.hub.gaps
        return np.asarray(y - self.blocks(U @ (self.joined @ (U.T @ y))))

    @cached_property
    def dense(self) -> Floats:
        """(k, k) N/m, the same as one matrix."""
        return self.apply(np.eye(sum(places.size for places, _ in self.parts)))


def _parts(k: int, entries: Entries) -> tuple[tuple[Indices, Floats], ...] | None:
    """Connected parts of a sparse symmetric matrix, and their inverses, by size; None if it has none or is singular."""
    rows, columns, values = (a[entries[2] != 0.0] for a in entries)
    label = np.arange(k)
    for _ in range(MOST_IN_PART + 1):
        before = label.copy()
        np.minimum.at(label, rows, before[columns])
        if np.array_equal(label, before):
            break
    else:
        return None
    sizes = np.bincount(label, minlength=k)  # a part has the label of its first connection
    if sizes.max(initial=0) > MOST_IN_PART:
        return None
    order = np.argsort(label, kind="stable")
    first = np.cumsum(sizes) - sizes
    position = np.empty_like(order)
    position[order] = np.arange(k) - first[label[order]]
    out = []
    for n in np.unique(sizes[sizes > 0]):
        labels = np.flatnonzero(sizes == n)
        which = np.full(k, -1)
        which[labels] = np.arange(len(labels))
        here = sizes[label[rows]] == n
        blocks = np.zeros((len(labels), n, n))
        np.add.at(blocks, (which[label[rows[here]]], position[rows[here]], position[columns[here]]), values[here])
        diagonal = np.einsum("bii->bi", blocks)
        if np.any(diagonal <= 0.0) or np.abs(blocks - blocks.swapaxes(1, 2)).max() > 1e-12 * np.abs(blocks).max():
            return None
        scale = 1 / np.sqrt(diagonal)
        scale_of_pair = scale[:, :, None] * scale[:, None]
        inverses = np.ones_like(blocks)
        if n > 1:
            block_inverses = [_inverse(block) for block in blocks * scale_of_pair]
            if any(inverse is None for inverse in block_inverses):
                return None
            inverses = np.array(block_inverses)
        inverses = inverses * scale_of_pair
        out.append((order[first[labels][:, None] + np.arange(n)], 0.5 * (inverses + inverses.swapaxes(1, 2))))
    return tuple(out)
