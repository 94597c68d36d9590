"""Base class of pickups with a one-way bank of modes: sound pressure, one readout per channel."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TypeVar

from tonewood.instrument.contract.base import Pickup, PickupRows, Scene
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.params import Parameters

P = TypeVar("P", bound=Parameters)


class Microphones(Pickup[P]):
    """Microphones that hear through modes of their own, which the forces on the body drive and nothing acts back on."""

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """The microphones."""

    @property
    def unit(self) -> str:
        """Sound pressure."""
        return "Pa"

    def bank_rows(
        self,
        name: str,
        basis: ModalBasis,
        drives: Sequence[Drive],
        inputs: Mapping[str, tuple[tuple[str, str, float], ...]],
        quantity: str = "displacement",
    ) -> PickupRows:
        """Return the rows of a bank with a point per channel.

        Parameters
        ----------
        name : of the group, and of the bank's component.
        basis : modes of the bank.
        drives : connections' forces on points of the bank; those without effect are left out.
        inputs : body point -> (component, point, factor), where a known force on the body drives the bank.
        quantity : of the bank's points that is pressure.
        """
        return PickupRows(
            readouts=tuple(Readout(f"{name}.{c}", quantity, (Term(name, c),)) for c in self.channels),
            components={name: basis},
            drives=tuple(drive for drive in drives if drive.factor != 0.0),
            body_inputs=inputs,
        )

    def at_points(
        self, name: str, scene: Scene, sign: float = 1.0
    ) -> tuple[list[str], list[Drive], dict[str, tuple[tuple[str, str, float], ...]]]:
        """Return the body's driven points, and the drives and inputs of a bank with a point ``at_POINT`` for each.

        Parameters
        ----------
        name : of the group, and of the bank's component.
        scene : points and forces of the instrument.
        sign : of the bank's inputs re the forces on the body.
        """
        driven = [point for point, body_point in scene.body_points.items() if body_point.driven]
        drives = [Drive(name, f"at_{f.point}", f.connection, sign * f.factor) for f in scene.bridge_forces]
        return driven, drives, {point: ((name, f"at_{point}", sign),) for point in driven}
