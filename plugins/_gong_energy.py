"""The potential of a plate of large deflection: von Karman's, of a simply supported rectangle.

A plate of sides a and b, thickness h and density rho that moves by w stretches its middle surface. With a stress
function F (von Karman; in modes Thomas & Bilbao, J. Sound Vib. 315 (2008) 569; Ducceschi, Touze, Bilbao & Webb, Acta
Mech. 225 (2014) 213),

    rho h w'' + D LapLap w = L(w, F),            LapLap F = -(E h / 2) L(w, w),
    L(f, g) = f_xx g_yy + f_yy g_xx - 2 f_xy g_xy.

With w = sum Phi_k y_k / sqrt(rho h), Phi_mn = 2 / sqrt(a b) sin(m pi x / a) sin(n pi y / b), and y mass-normalised,
the middle surface stores, beside the bending energy sum omega_k^2 y_k^2 / 2,

    V = (E h / 8) sum_j b_j^2 / zeta_j^4,    b_j = int Psi_j L(w, w),    dV/dy_k = -int F L(Phi_k, w) / sqrt(rho h),

a sum of squares of quadratic forms: V >= 0, V(s y) = s^4 V(y). The Psi_j are shapes of the stress function, with
LapLap Psi_j = zeta_j^4 Psi_j. They depend on the support of the edges in the plane of the plate:

=========  ============================================================================================================
sliding    a point of an edge moves along the edge without shear, not across it: Psi = cos cos, in closed form, zeta^4 =
           (kx^2 + ky^2)^2; and two mean tensions, which store (E h a b / 2 (1 - nu^2)) (ex^2 + ey^2 + 2 nu ex ey), ex
           and ey the means of w_x^2 / 2 and w_y^2 / 2
movable    the edges are free in the plane: F = F_n = 0 there, the shapes of a clamped plate. They have no closed form:
           F is a sum of products of polynomials that fulfil both conditions (J. Shen, SIAM J. Sci. Comput. 15 (1994)
           1489); the inverse of their biharmonic matrix, four blocks by parity, has all stress shapes at once
=========  ============================================================================================================

The integrals are sums over a grid. Every function is a product of one of x and one of y, and sums over modes and grid
points are done in one direction at a time. The table of coefficients int Psi_j L(Phi_p, Phi_q) has modes^2 x shapes
numbers, too many for a cache above 100 modes; the matrices here have some thousand. Every function is even or odd about
the middle of the plate, which halves the sums again in the compiled form (`_gong_energy_numba`). On a grid of 2 M + 2
cells (M the highest m or n) all products of sliding edges are integrated exactly; for movable edges the polynomials are
truncated: on a grid twice as fine (`PlateGrid.refined`) V changes by 3e-7 and its gradient by 5e-6 (random motion of 81
modes).

Valid while w_x is small against 1 and strains are elastic, up to some thicknesses of deflection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Edges = Literal["sliding", "movable"]

#: polynomials of the stress function along a side, beyond twice the highest number of half waves
_MORE_SHAPES = 10


@dataclass(frozen=True)
class GongPlate:
    """A rectangular plate, simply supported.

    Attributes
    ----------
    a, b : m, its sides along x and y.
    thickness : m.
    young : Pa.
    poisson : 1.
    density : kg/m^3.
    """

    a: float
    b: float
    thickness: float
    young: float
    poisson: float
    density: float

    @property
    def rigidity(self) -> float:
        """D = E h^3 / 12 (1 - nu^2), N m."""
        return self.young * self.thickness**3 / (12 * (1 - self.poisson**2))

    @property
    def surface_density(self) -> float:
        """Product rho h, kg/m^2."""
        return self.density * self.thickness

    def modes(self, freq_upper: float) -> tuple[NDArray[np.intp], Floats]:
        """Modes below a frequency (Hz), lowest first.

        Returns
        -------
        numbers : (n_modes, 2) half waves along x and y.
        omega : (n_modes,) rad/s, sqrt(D / rho h) (kx^2 + ky^2).
        """
        scale = np.sqrt(self.rigidity / self.surface_density)
        k2 = 2 * np.pi * freq_upper / scale
        counts = [int(np.sqrt(k2) * side / np.pi) + 1 for side in (self.a, self.b)]
        numbers = np.stack(np.meshgrid(*(np.arange(1, c + 1) for c in counts), indexing="ij"), -1).reshape(-1, 2)
        squared = ((numbers * np.pi / [self.a, self.b]) ** 2).sum(axis=1)
        order = np.argsort(squared, kind="stable")
        order = order[squared[order] < k2]
        return numbers[order], np.asarray(scale * squared[order], dtype=np.float64)

    def shapes(self, numbers: NDArray[np.intp], x: float, y: float) -> Floats:
        """(n_modes,) displacement per coordinate, 1/sqrt(kg), of modes at a point (m)."""
        at = np.sin(numbers * np.pi * np.array([x / self.a, y / self.b]))
        return np.asarray(2 / np.sqrt(self.a * self.b * self.surface_density) * at[:, 0] * at[:, 1])


def clamped_polynomials(count: int, x: Floats) -> Floats:
    """Shen's basis of functions that vanish with their slope at -1 and 1, and its derivatives.

    phi_j = c_j [L_j - 2 (2j + 5) / (2j + 7) L_j+2 + (2j + 3) / (2j + 7) L_j+4] with int phi_i'' phi_j'' = delta_ij.

    Returns
    -------
    (3, count, len(x)) values, slopes and second derivatives.
    """
    out = np.zeros((3, count, len(x)))
    for j in range(count):
        c = np.zeros(j + 5)
        c[[j, j + 2, j + 4]] = 1.0, -2 * (2 * j + 5) / (2 * j + 7), (2 * j + 3) / (2 * j + 7)
        c /= np.sqrt(2.0 * (2 * j + 3) ** 2 * (2 * j + 5))
        for d in range(3):
            out[d, j] = legendre.legval(x, legendre.legder(c, d))
    return out


def clamped_products(count: int, length: float) -> list[Floats]:
    """Integrals over a length of phi_i phi_j, phi_i' phi_j' and phi_i'' phi_j'' of `clamped_polynomials`."""
    x, q = legendre.leggauss(count + 5)
    f = clamped_polynomials(count, x)
    return [np.einsum("in,jn,n->ij", f[d], f[d], q) * (length / 2) ** (1 - 2 * d) for d in range(3)]


def biharmonic(counts: tuple[int, int], a: float, b: float) -> tuple[Floats, Floats]:
    """Matrices of int LapF LapG and int F G over a rectangle in products of `clamped_polynomials`, flattened."""
    (m0, m1, m2), (n0, n1, n2) = clamped_products(counts[0], a), clamped_products(counts[1], b)
    stiffness = np.kron(m2, n0) + 2 * np.kron(m1, n1) + np.kron(m0, n2)
    return np.asarray(stiffness, dtype=np.float64), np.asarray(np.kron(m0, n0), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PlateGrid:
    """V of the given modes of a plate, and its gradient.

    Attributes
    ----------
    plate : whose energy it is.
    numbers : (n_modes, 2) half waves of its modes along x and y.
    edges : ``sliding`` or ``movable``.
    finer : times as many shapes of the stress function (movable edges) and points of the grid.
    """

    plate: GongPlate
    numbers: NDArray[np.intp]
    edges: Edges = "sliding"
    finer: float = 1.0

    @property
    def refined(self) -> PlateGrid:
        """The same on a grid of twice as many points along each side."""
        return replace(self, finer=2 * self.finer)

    @cached_property
    def _highest(self) -> tuple[int, int]:
        mx, my = self.numbers.max(axis=0)
        return int(mx), int(my)

    @cached_property
    def stress_shapes(self) -> tuple[int, int]:
        """Functions of x and of y whose products the stress function consists of."""
        if self.edges == "sliding":
            return 2 * self._highest[0] + 1, 2 * self._highest[1] + 1
        mx, my = (int(np.ceil(self.finer * (2 * m + _MORE_SHAPES))) for m in self._highest)
        return mx, my

    @cached_property
    def points(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Places and weights of the grid along x and y, both in -1 .. 1."""

        def points_of(m: int, j: int) -> tuple[Floats, Floats]:
            if self.edges == "sliding":
                n = 2 * int(np.ceil(self.finer * (m + 1)))
                return 2 * (np.arange(n) + 0.5) / n - 1, np.full(n, 2 / n)
            n = int(np.ceil(self.finer * (np.pi * m / 2 + 6) + j / 2))
            places, weights = legendre.leggauss(n + n % 2)
            return np.asarray(places, dtype=np.float64), np.asarray(weights, dtype=np.float64)

        (mx, my), (jx, jy) = self._highest, self.stress_shapes
        return points_of(mx, jx), points_of(my, jy)

    @cached_property
    def stress(self) -> tuple[Floats, Floats]:
        """Functions of the stress function on the grid, times its weights: (jx, qx) and (jy, qy), m^(1/2)."""
        sides, out = (self.plate.a, self.plate.b), []
        for side, (g, w), j in zip(sides, self.points, self.stress_shapes, strict=True):
            i = np.arange(j)
            if self.edges == "sliding":
                values = np.cos(np.outer(i, (g + 1) * np.pi / 2)) * np.sqrt(np.where(i == 0, 1, 2) / side)[:, None]
            else:
                values = clamped_polynomials(j, g)[0]
            out.append(values * (w * side / 2))
        return out[0], out[1]

    @cached_property
    def compliance(self) -> Floats:
        """Inverse of the biharmonic operator on the stress shapes.

        Sliding edges: (jx, jy), 1 / zeta^4, and 0 for the constant; movable ones: (4, r, r) blocks of functions of the
        parities (even, even), (even, odd), (odd, even), (odd, odd), r the largest number of them, the rest 0.
        """
        (jx, jy), p = self.stress_shapes, self.plate
        if self.edges == "sliding":
            k2 = (np.arange(jx) * np.pi / p.a)[:, None] ** 2 + (np.arange(jy) * np.pi / p.b) ** 2
            return np.where(k2 > 0, 1 / np.maximum(k2, 1.0 / (p.a * p.b)) ** 2, 0.0)
        stiffness, _ = biharmonic((jx, jy), p.a, p.b)
        r = ((jx + 1) // 2) * ((jy + 1) // 2)
        out = np.zeros((4, r, r))
        for q, at in enumerate(self._parities):
            inverse = np.linalg.inv(stiffness[np.ix_(at, at)])
            out[q, : len(at), : len(at)] = 0.5 * (inverse + inverse.T)
        return out

    @cached_property
    def _parities(self) -> list[NDArray[np.intp]]:
        jx, jy = self.stress_shapes
        i, j = np.divmod(np.arange(jx * jy), jy)
        return [np.flatnonzero((i % 2 == p) & (j % 2 == q)) for p in (0, 1) for q in (0, 1)]

    @cached_property
    def waves(self) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
        """Mode shapes on the grid: (qx, mx) S_x, S_x'', S_x' and (my, qy) S_y, S_y'', S_y' of w = S_x c S_y."""
        p, (mx, my), ((gx, _), (gy, _)) = self.plate, self._highest, self.points
        kx, ky = np.arange(1, mx + 1) * np.pi / p.a, np.arange(1, my + 1) * np.pi / p.b
        x, y = np.outer((gx + 1) * p.a / 2, kx), np.outer(ky, (gy + 1) * p.b / 2)
        norm = 2 / np.sqrt(p.a * p.b * p.surface_density)
        sx, cx, sy, cy = norm * np.sin(x), norm * np.cos(x) * kx, np.sin(y), np.cos(y) * ky[:, None]
        return sx, -sx * kx**2, cx, sy, -sy * ky[:, None] ** 2, cy

    @cached_property
    def means(self) -> tuple[Floats, Floats, float]:
        """(n_modes,) ex and ey per y^2 / 2, 1/(kg m^2), and E h a b / (1 - nu^2), N m; 0 for movable edges."""
        p = self.plate
        k = self.numbers * np.array([np.pi / p.a, np.pi / p.b])
        per: Floats = k**2 / (p.a * p.b * p.surface_density)
        stiffness = p.young * p.thickness * p.a * p.b / (1 - p.poisson**2) if self.edges == "sliding" else 0.0
        return per[:, 0], per[:, 1], stiffness

    @cached_property
    def places(self) -> NDArray[np.intp]:
        """(n_modes,) place of each mode in the flattened matrix (mx, my) of coordinates."""
        return np.asarray((self.numbers[:, 0] - 1) * self._highest[1] + self.numbers[:, 1] - 1)

    def curvatures(self, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Derivatives w_xx, w_yy and w_xy on the grid, (qx, qy) each, 1/m, of coordinates (n_modes,)."""
        sx, sxx, cx, sy, syy, cy = self.waves
        c = np.zeros(self._highest)
        c.ravel()[self.places] = y
        return sxx @ c @ sy, sx @ c @ syy, cx @ c @ cy

    def airy(self, b: Floats) -> Floats:
        """(jx, jy) coefficients of -2 F / (E h), of b_j (jx, jy)."""
        if self.edges == "sliding":
            return self.compliance * b
        out, flat = np.zeros(b.size), b.ravel()
        for block, at in zip(self.compliance, self._parities, strict=True):
            out[at] = block[: len(at), : len(at)] @ flat[at]
        return out.reshape(b.shape)

    def _means(self, y: Floats) -> tuple[float, float, float]:
        """Mean strains ex and ey, and their energy, J."""
        ax, ay, stiffness = self.means
        ex, ey = 0.5 * float(ax @ y**2), 0.5 * float(ay @ y**2)
        return ex, ey, 0.5 * stiffness * (ex * ex + ey * ey + 2 * self.plate.poisson * ex * ey)

    def energy(self, y: Floats) -> float:
        """V, J, of coordinates (n_modes,), m sqrt(kg)."""
        wxx, wyy, wxy = self.curvatures(y)
        px, py = self.stress
        b = px @ (2 * (wxx * wyy - wxy * wxy)) @ py.T
        return self.plate.young * self.plate.thickness / 8 * float(np.vdot(b, self.airy(b))) + self._means(y)[2]

    def gradient(self, y: Floats) -> tuple[float, Floats]:
        """V, J, and dV/dy, (n_modes,), N / sqrt(kg), of coordinates (n_modes,), m sqrt(kg)."""
        p, (sx, sxx, cx, sy, syy, cy), (px, py) = self.plate, self.waves, self.stress
        wxx, wyy, wxy = self.curvatures(y)
        b = px @ (2 * (wxx * wyy - wxy * wxy)) @ py.T
        f = self.airy(b)
        value = p.young * p.thickness / 8 * float(np.vdot(b, f))
        force = p.young * p.thickness / 2 * (px.T @ f @ py)
        on = sxx.T @ (force * wyy) @ sy.T + sx.T @ (force * wxx) @ syy.T - 2 * (cx.T @ (force * wxy) @ cy.T)
        slope = on.ravel()[self.places]
        ax, ay, stiffness = self.means
        if stiffness > 0.0:
            ex, ey, stored = self._means(y)
            value += stored
            slope = slope + stiffness * ((ex + p.poisson * ey) * ax + (ey + p.poisson * ex) * ay) * y
        return value, slope

    @property
    def packed(self) -> Floats:
        """The arrays of `_gong_energy_numba.potential`, one after another.

        Points stand in two halves, the second the mirror images of the first, of which the functions have their values;
        functions of x or y stand in two groups: those of odd number of half waves first (even about the middle if they
        are sines), and of the stress shapes the even ones.
        """
        (mx, my), (jx, jy), ((gx, _), (gy, _)) = self._highest, self.stress_shapes, self.points
        hx, hy = len(gx) // 2, len(gy) // 2
        sx, sxx, cx, sy, syy, cy = self.waves
        px, py = self.stress
        wx, wy, fx, fy = _grouped(mx), _grouped(my), _grouped(jx), _grouped(jy)
        of_x = [f[:hx, wx] for f in (sx, sxx, cx)]
        of_y = [f[wy, :hy] for f in (sy, syy, cy)]
        stress = px[fx, :hx], py[fy, :hy]
        place_x, place_y = np.argsort(wx), np.argsort(wy)
        places = place_x[self.numbers[:, 0] - 1] * my + place_y[self.numbers[:, 1] - 1]
        ax, ay, stiffness = self.means
        modulus = self.plate.young * self.plate.thickness
        if self.edges == "sliding":
            compliance, r = self.compliance[np.ix_(fx, fy)], 0
        else:
            compliance, r = self.compliance, self.compliance.shape[1]
        head = [mx, my, hx, hy, jx, jy, r, modulus, self.plate.poisson, stiffness]
        arrays = (
            head, *of_x, *(f.T for f in of_x), *of_y, *(f.T for f in of_y), stress[0], stress[0].T,
            stress[1], stress[1].T, compliance, places, ax, ay,
        )  # fmt: skip
        data = np.concatenate([np.ravel(np.asarray(a, dtype=np.float64)) for a in arrays])
        return data

    @property
    def scratch(self) -> int:
        """Numbers that `_gong_energy_numba.potential` works in."""
        (mx, my), (jx, jy), ((gx, _), (gy, _)) = self._highest, self.stress_shapes, self.points
        hx, hy = len(gx) // 2, len(gy) // 2
        kept = 2 * mx * my + 2 * mx * hy + 16 * hx * hy + 2 * jx * hy + 2 * jx * jy
        return kept + 4 * max(hx, jx, mx) * max(hy, jy, my)


def _grouped(count: int) -> NDArray[np.intp]:
    """Numbers 0 .. count - 1, the even ones first."""
    return np.concatenate([np.arange(0, count, 2), np.arange(1, count, 2)])
