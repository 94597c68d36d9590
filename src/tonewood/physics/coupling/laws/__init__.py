"""Nonlinear laws of connections: the interface, one file for each law, and the solve for their forces."""

from tonewood.physics.coupling.laws.base import NonlinearLaw, PotentialLaw
from tonewood.physics.coupling.laws.compiled import CompiledPotential, Scalar
from tonewood.physics.coupling.laws.contact import Contact
from tonewood.physics.coupling.laws.friction import Friction
from tonewood.physics.coupling.laws.sampled import SampledPotential
from tonewood.physics.coupling.laws.spring import HardeningSpring

__all__ = [
    "CompiledPotential",
    "Contact",
    "Friction",
    "HardeningSpring",
    "NonlinearLaw",
    "PotentialLaw",
    "SampledPotential",
    "Scalar",
]
