"""Modes of one component: poles, shapes at points, frequency responses, static compliance.

Three kinds of mode, distinguished by `kind`; every one is a real 2 x 2 block once it is stepped (see `propagator`):

* ``PAIR``   z' = lambda z + sum_i l_i f_i,  y_i = 2 Re(r_i z): one of two conjugate poles, Im lambda > 0;
* ``REAL``   z' = lambda z + sum_i l_i f_i,  y_i = r_i z: one real pole;
* ``BLOCK``  q' = p + sum_i Im(l_i) f_i,  p' = -omega^2 q - 2 sigma p + sum_i Re(l_i) f_i,  y_i = Re(r_i) q + Im(r_i) p:
  rigid-body, critically and over-damped modes, whose pole pair coincides or nearly so. Real modes have real shapes,
  which is q'' + 2 sigma q' + omega^2 q = sum_i l_i f_i, y_i = r_i q.

Shapes carry the normalisation of Fabre, Le Carrou & Chomette (2024), Eq. 20, in the left shape: l = psi_l / Pi.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.modal.responses import BLOCK as BLOCK
from tonewood.physics.modal.responses import PAIR as PAIR
from tonewood.physics.modal.responses import REAL as REAL
from tonewood.physics.modal.responses import ModalResponses
from tonewood.physics.modal.views import Modal, ModalViews
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.tables import properties_html

#: damping ratio above which a second-order mode is stepped as a block: at .7 the two poles are still well apart
_BLOCK_ABOVE = 0.7


@dataclass(frozen=True, eq=False)
class ModalBasis(ModalResponses, ModalViews):
    """Modes of one uncoupled component: poles, left and right shapes at named points, residual compliance.

        z_k' = lambda_k z_k + sum_i l_ik f_i,      y_i = 2 Re sum_k r_ik z_k + sum_j R_ij f_j      (``PAIR``)

    in m, N and s; l = psi_l / Pi holds the norm Pi of Fabre et al. (2024), Eq. 20. Real modes are mass-normalised.

    Attributes
    ----------
    poles : (n_modes,) complex, 1/s. The slower pole of a ``BLOCK``.
    kind : (n_modes,) uint8, ``PAIR``, ``REAL`` or ``BLOCK``.
    stiffness : (n_modes,) omega^2, 1/s^2 (modal stiffness per modal mass).
    damping_rate : (n_modes,) sigma, 1/s.
    points : names of the places where the component can be driven, joined or heard.
    right, left : (n_points, n_modes) complex shapes.
    residual : (n_points, n_points) m/N, symmetric: static compliance of the modes that were left out.
    shape : places between the named points, m -> (n_modes,) real shape; None where there are only named points.
    residual_at : (x, y) in m -> m/N, residual compliance between two places, of arrays element by element; None as
        above.
    places : point name -> position in m, where `shape` is given.
    metadata : further data of the maker of the basis (its plugin reads them when a stop changes).
    """

    shape: Callable[[float], Floats] | None = None
    residual_at: Callable[[ArrayLike, ArrayLike], Floats] | None = None
    places: Mapping[str, float] = field(default_factory=dict)
    metadata: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, p = self.poles.size, len(self.points)
        shapes_ok = self.right.shape == self.left.shape == (p, n) and self.residual.shape == (p, p)
        if not shapes_ok or not (self.kind.shape == self.stiffness.shape == self.damping_rate.shape == (n,)):
            raise ValueError(f"arrays of a basis of {n} modes at {p} points do not fit together")
        for name in ("poles", "stiffness", "damping_rate", "right", "left", "residual"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"{name} of a basis must be finite")
        if len(set(self.points)) != p:
            raise ValueError("two points of a basis have the same name")

    def __repr__(self) -> str:
        freq = self.natural_freq
        span = f", {freq.min():.6g} to {freq.max():.6g} Hz" if freq.size else ""
        kind = "real" if self.is_real else "complex"
        return f"ModalBasis({self.n_modes} {kind} modes{span}, points {', '.join(self.points)})"

    def _repr_html_(self) -> str:
        freq = self.natural_freq
        rows = {
            "modes": f"{self.n_modes} {'real' if self.is_real else 'complex'}",
            "natural frequencies": f"{freq.min():.6g} to {freq.max():.6g} Hz" if freq.size else "none",
            "points": ", ".join(self.points),
        }
        return properties_html("ModalBasis", rows)

    def _viewed(self) -> tuple[Modal, Mapping[str, str]]:
        return self, {point: point for point in self.points}

    @classmethod
    def real(
        cls,
        natural_freq_rad: ArrayLike,
        damping_rate: ArrayLike,
        points: Mapping[str, ArrayLike] | Mapping[str, float],
        *,
        modal_mass: ArrayLike = 1.0,
        shape: Callable[[float], Floats] | None = None,
        static_compliance: Callable[[float, float], float] | None = None,
        residual: ArrayLike | None = None,
        metadata: Mapping[str, object] | None = None,
    ) -> ModalBasis:
        """Make a basis of real modes q'' + 2 sigma q' + omega^2 q = phi f / m of any damping, rigid bodies included.

        Parameters
        ----------
        natural_freq_rad : (n_modes,) omega, rad/s, 0 for a rigid-body mode.
        damping_rate : (n_modes,) sigma = zeta omega, 1/s.
        points : name -> (n_modes,) shape, or name -> position in m when `shape` is given.
        modal_mass : (n_modes,) or scalar, kg (with unit-free shapes); shapes become mass-normalised, 1/sqrt(kg).
        static_compliance : (x, y) in m -> m/N of *all* modes; less that of the kept ones it is the residual.
        residual : (n_points, n_points) m/N instead of `static_compliance`.
        metadata : kept with the basis.

        Returns
        -------
        A basis of kind ``PAIR``, or ``BLOCK`` where a mode is rigid, critically or over-damped.

        Raises
        ------
        ValueError : a frequency is negative or not finite, or a damping rate not finite.
        """
        omega = np.atleast_1d(np.asarray(natural_freq_rad, dtype=np.float64))
        sigma = np.broadcast_to(np.asarray(damping_rate, dtype=np.float64), omega.shape).copy()
        scale = 1.0 / np.sqrt(np.broadcast_to(np.asarray(modal_mass, dtype=np.float64), omega.shape))
        if np.any(omega < 0) or not np.all(np.isfinite(omega)) or not np.all(np.isfinite(sigma)):
            raise ValueError("natural frequencies must be finite and not negative, damping rates finite")
        normal_shape = None
        if shape is not None:
            unscaled = shape
            normal_shape = lambda x: np.asarray(unscaled(x), dtype=np.float64) * scale  # noqa: E731
        rows, places = [], {}
        for name, point in points.items():
            given_shape = np.asarray(point, dtype=np.float64)
            if normal_shape is not None and given_shape.ndim == 0:
                places[name] = float(given_shape)
                rows.append(normal_shape(places[name]))
            else:
                rows.append(given_shape * scale)
        phi = np.array(rows, dtype=np.float64).reshape(len(points), omega.size)

        poles, kind, gain = second_order(omega, sigma)
        residual_at: Callable[[ArrayLike, ArrayLike], Floats] | None = None
        if static_compliance is not None:
            assert normal_shape is not None
            residual_at = _softened(static_compliance, normal_shape, omega > 0, -(omega**2))
            residual = [[float(residual_at(x, y)) for y in places.values()] for x in places.values()]
        return cls(
            poles=poles,
            kind=kind,
            stiffness=omega**2,
            damping_rate=sigma,
            points=tuple(points),
            right=phi.astype(np.complex128),
            left=(phi * gain).astype(np.complex128),
            residual=_residual(residual, len(points)),
            shape=normal_shape,
            residual_at=residual_at,
            places=places,
            metadata=dict(metadata or {}),
        )

    @classmethod
    def complex(
        cls,
        poles: ArrayLike,
        right: Mapping[str, ArrayLike],
        left: Mapping[str, ArrayLike] | None = None,
        *,
        norm: ArrayLike = 1.0,
        acoustic: Sequence[str] = (),
        shapes_of: str = "displacement",
        residual: ArrayLike | None = None,
        metadata: Mapping[str, object] | None = None,
    ) -> ModalBasis:
        """Make a basis of complex modes: poles and right shapes psi_r; left shapes follow where they are not given.

        Left shapes are psi_l / Pi with psi_l = psi_r at structural points and -psi_r at `acoustic` ones (Fabre et al.
        2024, Eq. 16). Shapes measured as displacement and *pressure* (``shapes_of="pressure"``) have their acoustic
        rows divided by lambda first (Eq. 17).

        Parameters
        ----------
        poles : (n_modes,) 1/s, one of each conjugate pair (Im > 0), or real.
        right, left : point name -> (n_modes,) complex. A given `left` already holds 1/Pi.
        norm : (n_modes,) or scalar, Pi of Eq. 20.
        acoustic : names of the points that are pressures (velocity potentials).
        residual : (n_points, n_points) m/N, static compliance of modes that are left out.
        metadata : kept with the basis.

        Raises
        ------
        ValueError : a pole has a negative imaginary part, points of the shapes differ, or `shapes_of` is neither.
        """
        lam = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
        if np.any(lam.imag < 0):
            raise ValueError("give one pole of each conjugate pair, the one with a positive imaginary part")
        unknown = set(acoustic) - set(right)
        if unknown:
            raise ValueError(f"acoustic points {sorted(unknown)} have no shape")
        if shapes_of not in ("displacement", "pressure"):
            raise ValueError(f"shapes_of is 'displacement' or 'pressure', not {shapes_of!r}")
        names = tuple(right)
        r = np.array([np.asarray(right[p], dtype=np.complex128) for p in names]).reshape(len(names), lam.size)
        sign = np.array([-1.0 if p in acoustic else 1.0 for p in names])[:, None]
        if shapes_of == "pressure":
            r = np.where(sign < 0, r / lam, r)
        if left is None:
            ell = sign * r / np.asarray(norm, dtype=np.complex128)
        else:
            if set(left) != set(right):
                raise ValueError("left and right shapes must name the same points")
            ell = np.array([np.asarray(left[p], dtype=np.complex128) for p in names]).reshape(r.shape)
        return cls(
            poles=lam,
            kind=np.where(lam.imag > 0, PAIR, REAL).astype(np.uint8),
            stiffness=np.abs(lam) ** 2,
            damping_rate=-lam.real,
            points=names,
            right=r,
            left=ell,
            residual=_residual(residual, len(names)),
            metadata=dict(metadata or {}),
        )

    @property
    def n_modes(self) -> int:
        """Number of modes, a conjugate pair counted once."""
        return int(self.poles.size)

    @property
    def natural_freq(self) -> Floats:
        """(n_modes,) undamped natural frequencies, Hz."""
        return np.sqrt(self.stiffness) / (2 * np.pi)

    @property
    def damping_ratio(self) -> Floats:
        """(n_modes,) zeta = sigma / omega; infinite for a damped rigid-body mode, 0 for an undamped one."""
        omega = np.sqrt(self.stiffness)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.damping_rate == 0, 0.0, self.damping_rate / omega)

    @property
    def is_real(self) -> bool:
        """Whether every mode is a mass-normalised real one: left = right up to the pair's factor -i / (2 omega_d)."""
        if np.any(self.kind == REAL) or np.any(self.right.imag != 0):
            return False
        pair = self.kind == PAIR
        expected = np.where(pair, self.right * (-0.5j / np.where(pair, self.poles.imag, 1.0)), self.right)
        scale = np.max(np.abs(self.left), initial=0.0)
        return bool(np.all(np.abs(self.left - expected) <= 1e-12 * scale))

    @cached_property
    def motion(self) -> Floats:
        """(6, n_modes) a .. f between a real mode's numbers (x, y) and its motion.

        q = a x,  q' = b x + c y,      x = d q,  y = e q + f q'.
        """
        pair, lam = self.kind == PAIR, self.poles
        turn = np.where(pair, lam.imag, 1.0)
        none, one = np.zeros(self.n_modes), np.ones(self.n_modes)
        return np.array(
            [
                np.where(pair, 2.0, 1.0),
                np.where(pair, 2 * lam.real, none),
                np.where(pair, -2 * lam.imag, one),
                np.where(pair, 0.5, 1.0),
                np.where(pair, lam.real / (2 * turn), none),
                np.where(pair, -0.5 / turn, one),
            ]
        )

    def with_places(self, places: Mapping[str, float]) -> ModalBasis:
        """Return the same basis with more named points, at places in m along the component.

        Raises
        ------
        ValueError : the component has no shape between its named points.
        """
        if self.shape is None or not self.is_real:
            raise ValueError("this component has named points only")
        new = {name: x for name, x in places.items() if name not in self.points}
        if not new:
            return self
        phi = np.array([self.shape(x) for x in new.values()])
        pair = self.kind == PAIR
        gain = np.where(pair, -0.5j / np.where(pair, self.poles.imag, 1.0), 1.0)
        p, n = len(self.points), len(new)
        residual = np.zeros((p + n, p + n))
        residual[:p, :p] = self.residual
        if self.residual_at is not None:
            xs = np.array([self.places[name] for name in self.points] + list(new.values()))
            between = self.residual_at(xs[:, None], xs[p:])
            residual[:, p:] = between
            residual[p:, :p] = between[:p].T
            residual[p:, p:] = 0.5 * (between[p:] + between[p:].T)
        return replace(
            self,
            points=self.points + tuple(new),
            right=np.vstack([self.right, phi.astype(np.complex128)]),
            left=np.vstack([self.left, phi * gain]),
            residual=residual,
            places={**self.places, **new},
        )

    def select(self, modes: NDArray[np.intp] | NDArray[np.bool_], *, fold: bool = True) -> ModalBasis:
        """Return a basis of some modes; with `fold` the static compliance of the others goes into the residual.

        The shape function of a component with places keeps only the same modes.
        """
        keep = np.zeros(self.n_modes, dtype=bool)
        keep[modes] = True
        residual, residual_at = self.residual, self.residual_at
        shape = None
        if self.shape is not None:
            whole = self.shape
            shape = lambda x: whole(x)[keep]  # noqa: E731
        if fold and not keep.all():
            residual = residual + self.static_of(~keep)
            if self.residual_at and self.shape:
                residual_at = _softened(self.residual_at, self.shape, ~keep, self.stiffness)
        return replace(
            self,
            poles=self.poles[keep],
            kind=self.kind[keep],
            stiffness=self.stiffness[keep],
            damping_rate=self.damping_rate[keep],
            right=self.right[:, keep],
            left=self.left[:, keep],
            residual=residual,
            shape=shape,
            residual_at=residual_at,
        )


def second_order(omega: Floats, sigma: Floats) -> tuple[Complexes, NDArray[np.uint8], Complexes]:
    """(n,) poles and kinds of q'' + 2 sigma q' + omega^2 q = f, and the factor that makes left shapes of right ones."""
    block = sigma**2 >= (_BLOCK_ABOVE * omega) ** 2
    damped = np.sqrt(np.maximum((omega - np.abs(sigma)) * (omega + np.abs(sigma)), 0.0))
    slow = np.sqrt(np.maximum(sigma**2 - omega**2, 0.0))
    poles = np.where(block & (sigma >= omega), -sigma + slow, -sigma + 1j * damped).astype(np.complex128)
    gain = np.where(block, 1.0, -0.5j / np.where(block, 1.0, damped))
    return poles, np.where(block, BLOCK, PAIR).astype(np.uint8), gain


def _softened(
    compliance: Callable[..., Any], shape: Callable[[float], Floats], modes: NDArray[np.bool_], stiffness: Floats
) -> Callable[[ArrayLike, ArrayLike], Floats]:
    """Compliance between two places, m/N, with that of some modes added: sum phi phi / stiffness."""

    def at(x: float, y: float) -> float:
        return float(compliance(x, y) + np.sum(shape(x)[modes] * shape(y)[modes] / stiffness[modes]))

    return np.vectorize(at, otypes=[np.float64])


def _residual(residual: ArrayLike | None, n_points: int) -> Floats:
    if residual is None:
        return np.zeros((n_points, n_points))
    out = np.asarray(residual, dtype=np.float64)
    if out.shape != (n_points, n_points):
        raise ValueError(f"the residual compliance of {n_points} points is ({n_points}, {n_points}), not {out.shape}")
    return 0.5 * (out + out.T)
