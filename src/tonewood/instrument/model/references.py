"""References between parts of an assembled instrument: components, points and connections that plugins name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from tonewood.errors import BundleError
from tonewood.physics.coupling.connections import Connection
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis

#: makes the error of a part of a reason
MakeError = Callable[[str], BundleError]


def by_part(connections: Iterable[Connection]) -> dict[str, list[Connection]]:
    """Part -> its connections."""
    out: dict[str, list[Connection]] = {}
    for connection in connections:
        out.setdefault(connection.part, []).append(connection)
    return out


def check_connections(
    connections: Iterable[Connection], components: Mapping[str, ModalBasis], taken: Iterable[str], fault: MakeError
) -> None:
    """Check that the connections of a part join points that are there and have names of their own.

    components : of the whole instrument.
    taken : names of connections before.
    fault : makes the error of the part.
    Raises BundleError : as `fault` makes it.
    """
    names = set(taken)
    for connection in connections:
        if connection.name in names:
            raise fault(f"there are two connections {connection.name!r}; names begin with the string's and the part's")
        names.add(connection.name)
        for term in connection.terms:
            _check_point(term.component, term.point, components, f"connection {connection.name!r}", fault)


def check_readouts(
    readouts: Sequence[Readout],
    drives: Sequence[Drive],
    components: Mapping[str, ModalBasis],
    connections: Iterable[str],
    fault: MakeError,
) -> None:
    """Check that the rows of a pickup read points and forces that are there.

    Raises BundleError : as `fault` makes it.
    """
    names = dict.fromkeys(connections)
    for readout in readouts:
        for probe in readout.probes:
            _check_point(probe.component, probe.point, components, f"readout {readout.name!r}", fault)
        for name, _ in readout.forces:
            if name not in names:
                raise fault(f"readout {readout.name!r}: there is no connection {name!r}{_among(names)}")
    for drive in drives:
        _check_point(drive.component, drive.point, components, "a drive", fault)
        if drive.connection not in names:
            raise fault(f"a drive of {drive.component!r}: there is no connection {drive.connection!r}{_among(names)}")


def _check_point(component: str, point: str, components: Mapping[str, ModalBasis], who: str, fault: MakeError) -> None:
    if component not in components:
        raise fault(f"{who}: there is no component {component!r}{_among(components)}")
    if point not in components[component].points:
        raise fault(f"{who}: {component} has no point {point!r}{_among(components[component].points)}")


def _among(names: Iterable[str]) -> str:
    """``; there are ...`` of the first ten names."""
    listed = [str(name) for name in names]
    more = f" and {len(listed) - 10} more" if len(listed) > 10 else ""
    return f"; there are {', '.join(listed[:10])}{more}"
