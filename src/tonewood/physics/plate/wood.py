"""Woods: elastic constants, density and loss factors, each with its source."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class Wood:
    """An orthotropic material in plane stress, which shears through its thickness.

    E_L, E_R : Pa, Young's moduli along and across the grain.
    G_LR : Pa, shear modulus in the plate's plane.
    nu_LR : Poisson's ratio, contraction across the grain under tension along it.
    density : kg/m^3.
    loss_L, loss_R, loss_shear : loss factors of E_L, E_R and of every shear modulus.
    G_LT, G_RT : Pa, shear moduli through the thickness of a quarter-sawn plate; infinite for one that does not shear.
    """

    E_L: float
    E_R: float
    G_LR: float
    nu_LR: float
    density: float
    loss_L: float = 0.0
    loss_R: float = 0.0
    loss_shear: float = 0.0
    G_LT: float = float("inf")
    G_RT: float = float("inf")

    @property
    def shears(self) -> bool:
        """Whether both shear moduli through the thickness are finite."""
        return bool(np.isfinite(self.G_LT) and np.isfinite(self.G_RT))

    def transverse(self, grain: float = 0.0) -> Floats:
        """(2, 2) Pa, of the transverse shear strains (g_xz, g_yz), the grain at an angle `grain` (rad) from x."""
        c, s = np.cos(grain), np.sin(grain)
        mixed = c * s * (self.G_LT - self.G_RT)
        return np.array(
            [[c * c * self.G_LT + s * s * self.G_RT, mixed], [mixed, s * s * self.G_LT + c * c * self.G_RT]]
        )

    def stiffness(self, grain: float = 0.0) -> Floats:
        """(3, 3) Pa, of the strains (e_xx, e_yy, 2 e_xy), the grain at an angle `grain` (rad) from x.

        In the wood's own axes Q11 = E_L/k, Q22 = E_R/k, Q12 = nu E_R/k, Q66 = G with k = 1 - nu^2 E_R/E_L; rotated as
        R. M. Jones, Mechanics of Composite Materials, 2nd ed. (1999), Eq. 2.80.
        """
        k = 1.0 - self.nu_LR**2 * self.E_R / self.E_L
        q12 = self.nu_LR * self.E_R / k
        return _rotated(np.array([[self.E_L / k, q12, 0.0], [q12, self.E_R / k, 0.0], [0.0, 0.0, self.G_LR]]), grain)

    def losses(self, grain: float = 0.0) -> Floats:
        """(3, 3) Pa, imaginary part of the stiffness; positive semidefinite.

        The coupling Q12 takes the geometric mean of both loss factors, for which no measurement is published.
        """
        factors = np.sqrt(np.array([self.loss_L, self.loss_R, self.loss_shear]))
        return _rotated(self.stiffness() * np.outer(factors, factors), grain)


def _rotated(matrix: Floats, grain: float) -> Floats:
    """Matrix of strains in axes turned by `grain`: T^T Q T with T from the drawing's strains to the wood's."""
    c, s = np.cos(grain), np.sin(grain)
    turn = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])
    return np.asarray(turn.T @ matrix @ turn)


@dataclass(frozen=True, slots=True)
class Species:
    """A wood of a species, and where its figures come from.

    wood : typical figures; a single board differs by up to a factor of two.
    source : of elastic constants and density.
    assumed : constants that the source does not give, and the values taken for them.
    """

    wood: Wood
    source: str
    assumed: str = ""


_HANDBOOK = "a guitar's finite-element database quoted without its source; Engelmann as in the Wood Handbook's ratios"
_PRESETS = "presets of a luthiers' calculator, quoted without their source; the range of boards is 20 % either way"
#: loss factors along, across and in shear: typical spruce, after values of the kind of Haines (1979), not read
_SPRUCE, _HARD = (0.0075, 0.020, 0.018), (0.010, 0.022, 0.020)
_LOSS = "loss factors are typical ones"

#: G_LT / E_L and G_RT / E_L: Wood Handbook (Forest Products Laboratory), table 5-1, as quoted in public files
_RATIOS = {
    "Sitka spruce": (0.061, 0.003), "Engelmann spruce": (0.120, 0.010), "western red cedar": (0.086, 0.005),
    "Honduras mahogany": (0.086, 0.028), "walnut": (0.062, 0.021),
}  # fmt: skip


def _sheared(wood: Wood, like: str) -> Wood:
    """Wood with the shear moduli through its thickness in the ratios of a species of the Handbook."""
    long, rolling = _RATIOS[like]
    return replace(wood, G_LT=long * wood.E_L, G_RT=rolling * wood.E_L)


#: name; E_L, E_R, G_LR, nu_LR and density; loss factors; species of its ratios; source; what is assumed
_TABLE = (
    ("sitka_spruce", (13.0e9, 0.90e9, 1.50e9, 0.372, 440.0), _SPRUCE, "Sitka spruce", _HANDBOOK, _LOSS),
    ("engelmann_spruce", (9.79e9, 1.25e9, 1.21e9, 0.422, 350.0), _SPRUCE, "Engelmann spruce", _HANDBOOK, _LOSS),
    ("european_spruce", (11.5e9, 0.85e9, 0.78e9, 0.37, 430.0), _SPRUCE, "Sitka spruce", _PRESETS,
     "E_L at the lower end of the range 12 to 17 GPa, G_LR 0.068 E_L, nu_LR, G_LT and G_RT as of Sitka spruce; "
     + _LOSS),
    ("western_red_cedar", (8.5e9, 0.70e9, 0.74e9, 0.378, 350.0), _SPRUCE, "western red cedar", _PRESETS,
     f"G_LR 0.087 E_L, nu_LR of softwoods; {_LOSS}"),
    ("maple", (12.6e9, 2.2e9, 1.63e9, 0.424, 600.0), _HARD, "walnut", _HANDBOOK,
     f"G_LT and G_RT as of walnut, as nobody measured the G_RT of maple; {_LOSS}"),
    ("mahogany", (10.1e9, 1.5e9, 1.32e9, 0.300, 545.0), _HARD, "Honduras mahogany", _HANDBOOK, _LOSS),
    ("indian_rosewood", (12.8e9, 0.90e9, 1.0e9, 0.36, 830.0), _HARD, "walnut", _PRESETS,
     f"G_LR 0.08 E_L, nu_LR of hardwoods, G_LT and G_RT as of walnut; {_LOSS}"),
    ("brazilian_rosewood", (14.0e9, 1.0e9, 1.1e9, 0.36, 880.0), _HARD, "walnut", _PRESETS,
     f"G_LR 0.08 E_L, nu_LR of hardwoods, G_LT and G_RT as of walnut; {_LOSS}"),
)  # fmt: skip
SPECIES: dict[str, Species] = {
    name: Species(_sheared(Wood(*constants, *losses), like), source, assumed)
    for name, constants, losses, like, source, assumed in _TABLE
}
