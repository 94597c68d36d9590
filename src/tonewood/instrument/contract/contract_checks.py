"""Methods of plugins with their results checked: a wrong result or an exception ends in one line that names the method.

`check_results` wraps the methods of the contract that a class defines. A result is checked for its type, for finite
numbers and for the shapes that the contract promises; an exception that is not a `TonewoodError` becomes one, from
which the first still hangs, so that its traceback is there in Python.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError, kind_of, words_of
from tonewood.instrument.contract.conversion import Circuit, Conversion
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws import NonlinearLaw
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import MOST_MODES
from tonewood.physics.stepping.forcing import SampledForce, Segment
from tonewood.support.arrays import read_only

#: check of a result, which raises `WrongResultError`: object, result, arguments of the call
Verify = Callable[[Any, Any, Mapping[str, Any]], None]


_CONTRACT = "tonewood.instrument.contract.base"
#: s, before and after its event, in which a gesture acts
_LONGEST_GESTURE = 3600.0
#: loss factor of a partial; from 2 on it does not oscillate
_HIGHEST_LOSS = 100.0
#: largest number of a law, and m, largest gap at which it begins: powers of greater ones are no numbers
_LARGEST_OF_LAW, _LARGEST_OFFSET = 1e30, 1e3


class WrongResultError(Exception):
    """A result breaks the contract; the text goes on from ``returns``."""


def want(ok: object, value: object, requirement: str, where: str = "") -> None:
    """Raise `WrongResultError` unless `ok`: ``EvenString.length returns 'long'; a number above 0 is wanted``."""
    if not ok:
        text = repr(value)
        shown = text if len(text) <= 60 and "\n" not in text else kind_of(value)
        raise WrongResultError(f"{where} {shown}; {requirement} is wanted".strip())


def number(value: object, requirement: str, low: float = -math.inf, where: str = "", *, above: bool = False) -> None:
    """Check a finite number, `low` or more, or above it."""
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    most = sys.float_info.max  # an integer may be greater
    plain: Any = value.item() if isinstance(value, np.generic) else value  # a number of 32 bits has no such limit
    fits = real and -most <= plain <= most and (plain > low if above else plain >= low)
    want(fits, value, requirement, where)


def pair_of_arrays(value: Any, shape: tuple[int, ...]) -> None:
    """Check displacement and velocity of a `transfer` or `carried`."""
    want(isinstance(value, tuple) and len(value) == 2, value, "a pair (displacement, velocity) of arrays")
    for quantity, array in zip(("displacement", "velocity"), value, strict=True):
        want(isinstance(array, np.ndarray), array, "an array", quantity)
        if array.shape != shape:
            size = " x ".join(map(str, shape))
            raise WrongResultError(f"{quantity} of shape {array.shape}; {size} is wanted")
        want(np.isfinite(array).all(), "numbers that are not finite", "a finite array", quantity)


def basis(value: Any, *, where: str = "") -> None:
    """Check a basis for its type and its numbers."""
    want(isinstance(value, ModalBasis), value, "a ta.ModalBasis", where)
    for name in ("poles", "stiffness", "damping_rate", "right", "left", "residual"):
        if not np.isfinite(getattr(value, name)).all():
            raise WrongResultError(f"{where} a basis whose {name} are not finite".strip())


def brought_basis(value: Any, where: str) -> None:
    """Check a basis that a part brings: no mode may grow by itself."""
    basis(value, where=where)
    growth = float(np.max(value.poles.real, initial=0.0))
    if growth > 0.0:
        raise WrongResultError(f"{where} a basis of which a mode grows at {growth:g} 1/s; none may grow")


def string_basis(value: Any) -> None:
    """Check a basis of a string: real modes that lose energy or keep it, the bridge's point, shapes between places."""
    basis(value)
    if not value.is_real:
        raise WrongResultError("a basis of complex modes; real modes are wanted")
    if value.n_modes > MOST_MODES:
        raise WrongResultError(f"a basis of {value.n_modes} modes; at most {MOST_MODES} are allowed")
    if "bridge" not in value.points:
        raise WrongResultError(
            f"a basis of the points {', '.join(value.points) or 'none'}; 'bridge' is wanted among them"
        )
    if (value.damping_rate < 0).any():
        raise WrongResultError(f"a damping rate of {value.damping_rate.min():g} 1/s; 0 or more is wanted")
    if value.shape is None:
        raise WrongResultError(
            "a basis without `shape`, whose points between the ends are unknown; ta.string_basis has one"
        )


def terms(value: object, where: str) -> None:
    """Check the terms of a gap."""
    want(isinstance(value, Sequence), value, "a tuple of ta.Term", where)
    for term in value:  # type: ignore[attr-defined]  # a sequence, by the line above
        want(isinstance(term, Term), term, "a ta.Term", where)
        names(term, where)
        number(term.factor, "a finite factor", where=where)


def names(term: Any, where: str) -> None:
    """Check that component and point of a term are names."""
    for name in (term.component, term.point):
        want(isinstance(name, str), name, "the name of a component and that of its point, as texts,", where)


def law(value: Any, where: str) -> None:
    """Check a law of a connection for its type and its numbers."""
    is_law = isinstance(value, (Rigid, SpringDashpot, NonlinearLaw))
    want(is_law, value, "a law, as ta.Contact or ta.SpringDashpot,", where)
    for field in dataclasses.fields(value) if dataclasses.is_dataclass(value) else ():
        most = _LARGEST_OFFSET if field.name == "offset" else _LARGEST_OF_LAW
        size = getattr(value, field.name)
        if isinstance(size, (int, float)) and not isinstance(size, bool):
            want(-most <= size <= most, size, f"a number from {-most:g} to {most:g}", f"{where}: {field.name}")


def attached(value: Any) -> None:
    """Check the places, components and connections that a part adds to a string."""
    from tonewood.instrument.contract.attached import Attached

    want(isinstance(value, Attached), value, "a ta.Attached")
    want(isinstance(value.places, Mapping), value.places, "a mapping of point to metres", "places")
    for point, x in value.places.items():
        number(x, "a number of metres from the bridge (ta.metres)", where=f"places[{point!r}]")
    want(isinstance(value.components, Mapping), value.components, "a mapping of name to ta.ModalBasis", "components")
    for name, component in value.components.items():
        brought_basis(component, f"components[{name!r}]")
    want(isinstance(value.connections, tuple), value.connections, "a tuple of ta.Connection", "connections")
    for connection in value.connections:
        want(isinstance(connection, Connection), connection, "a ta.Connection", "connections")
        want(isinstance(connection.name, str), connection.name, "a text", "the name of a connection")
        terms(connection.terms, f"connection {connection.name!r}: terms")
        law(connection.law, f"connection {connection.name!r}: law")
    names = {connection.name for connection in value.connections}
    for name in value.resting:
        want(name in names, name, "the name of one of its connections", "resting")
    want(isinstance(value.inputs, Mapping), value.inputs, "a mapping of name to entries", "inputs")


def potentials(value: Any) -> None:
    """Check energies beside those of modes."""
    want(isinstance(value, (list, tuple)), value, "a list of ta.Potential")
    for potential in value:
        want(isinstance(potential, Potential), potential, "a ta.Potential", "among its potentials")


def segments(value: Any, where: str) -> None:
    """Check pieces of a force."""
    want(isinstance(value, tuple), value, "a tuple of ta.Segment", where)
    for piece in value:
        want(isinstance(piece, Segment), piece, "a ta.Segment", where)
        for field in ("start", "stop", "c0", "c1", "c2"):
            number(getattr(piece, field), "a finite number", where=f"{where}: {field}")
        want(piece.start <= piece.stop, piece, "a start before the stop", where)
        near = piece.start >= -_LONGEST_GESTURE and piece.stop <= _LONGEST_GESTURE
        want(near, piece, f"times of at most {_LONGEST_GESTURE:g} s", where)


def gesture(value: Any) -> None:
    """Check a gesture."""
    from tonewood.instrument.contract.attached import Motion
    from tonewood.instrument.contract.gestures import Gesture, Hold

    want(isinstance(value, Gesture), value, "a ta.Gesture")
    segments(value.segments, "segments")
    segments(value.stops, "stops")
    if value.from_bridge is not None:
        number(value.from_bridge, "a number of metres (ta.metres) or None", 0.0, "from_bridge")
    number(value.angle_deg, "a number of degrees", where="angle_deg")
    number(value.width, "a width in metres, 0 or more,", 0.0, "width")
    want(value.on is None or isinstance(value.on, str), value.on, "the name of an input or None", "on")
    want(value.hold is None or isinstance(value.hold, Hold), value.hold, "a ta.Hold or None", "hold")
    if value.hold is not None:
        number(value.hold.damping, "0 N s/m or more", 0.0, "hold.damping")
        for field in ("start", "grown", "stop"):
            number(getattr(value.hold, field), "a time in s", where=f"hold.{field}")
    noise = value.noise
    want(noise is None or isinstance(noise, SampledForce), noise, "a ta.SampledForce or None", "noise")
    if noise is not None:
        _sampled(noise)
    want(isinstance(value.motions, tuple), value.motions, "a tuple of motions", "motions")
    for motion in value.motions:
        want(isinstance(motion, Motion), motion, "a ta.Motion", "motions")
        segments(motion.segments, f"motion of {motion.connection}")
    want(isinstance(value.touches, Mapping), value.touches, "a mapping of point to segments", "touches")
    for point, course in value.touches.items():
        segments(course, f"touches[{point!r}]")
        want(course, course, "one segment or more", f"touches[{point!r}]")


def _sampled(noise: SampledForce) -> None:
    """Check a force that is given by its values."""
    number(noise.start, "a time in s", where="noise.start")
    number(noise.interval, "a number of seconds above 0", 0.0, "noise.interval", above=True)
    values = noise.values
    real = isinstance(values, np.ndarray) and values.ndim == 1 and values.size and values.dtype.kind in "fi"
    want(real, values, "an array (n,) of one or more real numbers", "noise.values")
    want(np.isfinite(values).all(), "values that are not finite", "finite values", "noise")
    near = noise.start >= -_LONGEST_GESTURE and noise.stop <= _LONGEST_GESTURE
    want(near, (noise.start, noise.stop), f"times of at most {_LONGEST_GESTURE:g} s", "noise")


def _circuit(circuit: Any) -> None:
    want(isinstance(circuit, Circuit), circuit, "a ta.Circuit or None", "conversion.circuit")
    for name in ("numerator", "denominator"):
        coefficients = getattr(circuit, name)
        want(isinstance(coefficients, Sequence) and len(coefficients), coefficients, "a tuple of numbers", name)
        for coefficient in coefficients:
            number(coefficient, "a finite number", where=f"conversion.circuit: {name}")
    want(circuit.denominator[0] != 0, circuit.denominator, "a first coefficient other than 0", "denominator")
    proper = len(circuit.numerator) <= len(circuit.denominator) and bool(np.all(circuit.poles.real < 0))
    want(proper, circuit.denominator, "a stable and proper circuit", "conversion.circuit")


def _without_memory(function: Callable[[Any], Any], n: int, n_channels: int) -> None:
    """Check that a conversion makes finite channels of small readouts, each row by itself."""
    readouts = 1e-6 * np.cos(np.arange(1.0, 3 * n + 1)).reshape(3, n)
    together, alone = (np.asarray(function(rows.copy())) for rows in (readouts, readouts[1:2]))
    shape, where = (3, n_channels), "conversion.function"
    want(together.shape == shape and together.dtype.kind in "fi", together, f"an array {shape} of real numbers", where)
    if not np.isfinite(together).all():
        raise WrongResultError(f"a {where} whose channels of small readouts are not finite")
    if alone.shape != (1, n_channels) or not np.allclose(alone[0], together[1], rtol=1e-9, atol=0.0):
        raise WrongResultError(f"a {where} of a row and of its neighbours; one of each row alone is wanted")


def pickup_rows(plugin: Any, value: Any) -> None:
    """Check rows of a pickup; that their components and points exist, `references` checks."""
    want(isinstance(value, _class(_CONTRACT, "PickupRows")), value, "a ta.PickupRows")
    want(isinstance(value.readouts, tuple), value.readouts, "a tuple of ta.Readout", "readouts")
    for readout in value.readouts:
        want(isinstance(readout, Readout), readout, "a ta.Readout", "readouts")
        for probe in readout.probes:
            where = f"readout {readout.name!r}: probes"
            want(all(hasattr(probe, k) for k in ("component", "point", "factor")), probe, "a ta.Term", where)
            names(probe, where)
            number(probe.factor, "a finite factor", where=where)
        for force in readout.forces:
            where = f"readout {readout.name!r}: forces"
            pair = isinstance(force, Sequence) and len(force) == 2 and isinstance(force[0], str)
            want(pair, force, "a pair (connection, factor)", where)
            number(force[1], "a finite factor", where=where)
        empty = "probes" if readout.quantity != "force" else "forces"
        want(getattr(readout, empty), f"a readout {readout.name!r} without {empty}", f"a {readout.quantity} of some")
    conversion, n = value.conversion, len(value.readouts)
    want(conversion is None or isinstance(conversion, Conversion), conversion, "a ta.Conversion or None", "conversion")
    if conversion is not None and conversion.function is not None:
        rest = conversion.function(np.zeros((1, n)))
        shape = (1, len(plugin.channels))
        want(
            np.shape(rest) == shape and not np.any(rest), rest, f"zeros of shape {shape} at rest", "conversion.function"
        )
        _without_memory(conversion.function, n, len(plugin.channels))
    elif n != len(plugin.channels):
        raise WrongResultError(
            f"{len(value.readouts)} readouts; one for each of its {len(plugin.channels)} channels is wanted"
        )
    if conversion is not None and conversion.circuit is not None:
        _circuit(conversion.circuit)
    for name, component in value.components.items():
        brought_basis(component, f"components[{name!r}]")
    for drive in value.drives:
        want(isinstance(drive, Drive), drive, "a ta.Drive", "drives")


def texts(value: Any, requirement: str, *, some: bool) -> None:
    """Check a sequence of words."""
    listed = isinstance(value, (tuple, list)) and all(isinstance(word, str) for word in value)
    want(listed and (value or not some), value, requirement)


def body_points(value: Any) -> None:
    """Check the points of a body."""
    want(isinstance(value, Mapping) and value, value, "a mapping of name to ta.BodyPoint")
    for name, point in value.items():
        want(isinstance(point, _class(_CONTRACT, "BodyPoint")), point, "a ta.BodyPoint", f"points[{name!r}]")
        vector = np.asarray(point.direction, dtype=object).ravel()
        want(len(vector) == 3, point.direction, "three numbers", f"the direction of {name!r}")
        for x in vector:
            number(x, "a finite number", where=f"the direction of {name!r}")


def _detuned(plugin: Any, value: Any, arguments: Mapping[str, Any]) -> None:
    string_basis(value)
    old = arguments["basis"]
    want(value.n_modes == old.n_modes, value.n_modes, f"as many modes as before, {old.n_modes},", "modes:")
    want(value.points == old.points, value.points, f"the points as before, {old.points},", "points")


def _body_basis(plugin: Any, value: Any, arguments: Mapping[str, Any]) -> None:
    basis(value)
    for point in plugin.points():
        want(point in value.points, value.points, f"a basis with the point {point!r} of `points`", "the points")


def _decay_rate(plugin: Any, value: Any, arguments: Mapping[str, Any]) -> None:
    if value is not None:
        array, shape = np.asarray(value), np.shape(arguments["freq_rad"])
        fits = array.dtype.kind in "fi" and array.shape in ((), shape)
        fits = fits and bool(np.isfinite(array).all() and (array >= 0).all())
        want(fits, value, f"finite rates of shape {shape}, 0 or more,")


def _loss_factor(plugin: Any, value: Any, arguments: Mapping[str, Any]) -> None:
    omega = np.asarray(arguments["omega"], dtype=np.float64)
    array = np.asarray(value)
    want(array.dtype.kind in "fi" and array.shape in ((), omega.shape), value, f"loss factors of shape {omega.shape}")
    wrong = np.flatnonzero(~(np.isfinite(array) & (array >= 0.0)))
    if wrong.size:
        i, flat = int(wrong[0]), np.broadcast_to(array, omega.shape).ravel()
        at = f" at {omega.ravel()[i] / (2 * np.pi):.6g} Hz" if omega.size else ""
        raise WrongResultError(f"eta = {flat[i] if omega.size else array:g}{at}; it must be 0 or more")
    if array.size and array.max() > _HIGHEST_LOSS:
        raise WrongResultError(
            f"eta = {array.max():g}; it is 2 sigma / omega, and at most {_HIGHEST_LOSS:g} is allowed"
        )


def _class(module: str, name: str) -> type[Any]:
    """Class of a module that imports this one, or that only a plugin that uses it has imported."""
    cls: type[Any] = getattr(sys.modules[module], name, type(None)) if module in sys.modules else type(None)
    return cls


def _of_type(module: str, name: str) -> Verify:
    """Check for None or an instance of a class, imported when it is needed."""

    def verify(plugin: Any, value: Any, arguments: Mapping[str, Any]) -> None:
        if value is not None:
            want(isinstance(value, _class(module, name)), value, f"a ta.{name} or None")

    return verify


#: kind of plugin -> method or property -> check of its result
CHECKS: dict[str, dict[str, Any]] = {
    "resonator": {
        "length": lambda p, v, a: number(v, "a number of metres above 0", 0.0, above=True),
        "tension": lambda p, v, a: number(v, "a number of newtons above 0", 0.0, above=True),
        "linear_density": lambda p, v, a: number(v, "a number of kg/m, 0 or more,", 0.0),
        "bending_stiffness": lambda p, v, a: number(v, "a number of N m^2, 0 or more,", 0.0),
        "loss": _loss_factor,
        "longitudinal": _of_type(_CONTRACT, "Longitudinal"),
        "potentials": lambda p, v, a: potentials(v),
        "basis": lambda p, v, a: string_basis(v),
        "detuned": _detuned,
        "decay_rate": _decay_rate,
        "transfer": lambda p, v, a: pair_of_arrays(v, (a["new"].n_modes, a["old"].n_modes)),
        "carried": lambda p, v, a: pair_of_arrays(v, (a["new"].n_modes,)),
    },
    "loss": {"eta": _loss_factor},
    "body": {
        "basis": _body_basis,
        "points": lambda p, v, a: body_points(v),
        "potentials": lambda p, v, a: potentials(v),
        "sources": _of_type("tonewood.physics.plate.radiation", "Sources"),
        "mass": lambda p, v, a: None if v is None else number(v, "a mass of 0 kg or more, or None,", 0.0),
        "facts": lambda p, v, a: texts(v, "lines of text", some=False),
    },
    "exciter": {
        "at": lambda p, v, a: want(v is None or isinstance(v, str), v, "'body.POINT' or None"),
        "recovery": lambda p, v, a: number(v, "a number of seconds, 0 or more,", 0.0),
        "attach": lambda p, v, a: None if v is None else attached(v),
        "gesture": lambda p, v, a: gesture(v),
    },
    "connection": {"attach": lambda p, v, a: attached(v)},
    "pickup": {
        "channels": lambda p, v, a: texts(v, "a tuple of one or more names", some=True),
        "unit": lambda p, v, a: want(isinstance(v, str), v, "a unit, as text,"),
        "rows": lambda p, v, a: pickup_rows(p, v),
    },
}


def check_results(cls: type[Any], checks: Mapping[str, Any], fault: Callable[[Any, str], TonewoodError]) -> None:
    """Replace the methods of a class that `checks` names by ones whose results are checked.

    cls : the class; inherited methods are left as they are.
    checks : name -> check of a result: object, result, arguments by name; raises `WrongResultError`.
    fault : makes the error of an object and a reason.
    """
    for name, verify in checks.items():
        member = cls.__dict__.get(name)
        if isinstance(member, property) and member.fget is not None:
            setattr(cls, name, property(_checked(cls, name, member.fget, verify, fault), doc=member.__doc__))
        elif isinstance(member, functools.cached_property):
            wrapped = functools.cached_property(_checked(cls, name, member.func, verify, fault))
            wrapped.__set_name__(cls, name)
            setattr(cls, name, wrapped)
        elif inspect.isfunction(member):
            setattr(cls, name, _checked(cls, name, member, verify, fault))


def _checked(
    cls: type[Any], name: str, function: Callable[..., Any], verify: Any, fault: Callable[[Any, str], TonewoodError]
) -> Callable[..., Any]:
    if getattr(function, "__isabstractmethod__", False):
        return function
    # by the names of the contract, whatever the class calls its parameters
    first = next((base.__dict__[name] for base in reversed(cls.__mro__) if name in base.__dict__), function)
    signature = inspect.signature(first if inspect.isfunction(first) else function)
    names = tuple(signature.parameters)
    who = f"{cls.__name__}.{name}"

    @functools.wraps(function)
    def call(self: Any, *args: Any, **kwargs: Any) -> Any:
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused below, in one line
                value = function(self, *map(read_only, args), **{k: read_only(v) for k, v in kwargs.items()})
        except (TonewoodError, MemoryError):
            raise
        except (Exception, SystemExit, GeneratorExit) as raised:  # told with class, method and key
            raise fault(self, f"{who} {raises(raised)}") from raised
        try:
            # the call went well: without keywords its arguments have the names in their order
            positional = dict(zip(names, (self, *args), strict=False))
            verify(self, value, signature.bind(self, *args, **kwargs).arguments if kwargs else positional)
        except WrongResultError as wrong:
            raise fault(self, f"{who} returns {wrong}") from None
        except (Exception, SystemExit) as odd:  # an iterator, a sequence or a function of somebody's that fails
            raise fault(self, f"{who} returns {kind_of(value)} that cannot be used: it {raises(odd)}") from odd
        return value

    return call


def raises(raised: BaseException) -> str:
    """``raises ValueError: its text (file.py, line 12)``."""
    return f"raises {words_of(raised)}{_place(raised)}"


def _place(raised: BaseException) -> str:
    """`` (file.py, line 12)`` of the innermost frame."""
    trace = raised.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f" ({Path(trace.tb_frame.f_code.co_filename).name}, line {trace.tb_lineno})"
