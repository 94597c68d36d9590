"""Assembled models in files that a program without Python can play: see docs/embedding.md.

A file holds named arrays: first the line ``tonewood-arrays/1``, then for each array a line ``name type n0 n1 ...``
(type ``f8`` or ``i8``, sizes in decimal; none for a single number) and right after its newline the numbers,
little-endian, 8 bytes each, the last index fastest. Numbers are finite, names consist of letters, digits and ``_/.-``.
``src/embed/arrays.hpp`` reads it.

Names are the paths of `KernelStepper.describe`, ``components/0/e``. Beside these stand ``capacity`` (modes of the
state), ``n_channels``, ``fs`` (Hz, of the steps), ``scale`` (n_channels,) from readouts to full scale, and known forces
``plucks/i/j/0`` to ``3``: slot, first step, vectors and values of injection j of pluck i.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import OutputError, TonewoodError
from tonewood.instrument.contract.gestures import Event
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.gestures import forces
from tonewood.performance.player.timeline import Play, Timeline
from tonewood.physics.coupling.system import Compiled, Injection, System
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.sound.files.inputs import InstrumentLike, as_instrument
from tonewood.sound.render.routing import Routing
from tonewood.support.blas import one_blas_thread
from tonewood.support.whole_files import AtomicFile

MAGIC = b"tonewood-arrays/1\n"
#: Hz; the reader takes no rate above the second
LOWEST_FS, HIGHEST_FS = 1e3, 1e7
Arrays = dict[str, NDArray[Any]]


@one_blas_thread
def save_model(
    path: str | os.PathLike[str],
    instrument: InstrumentLike,
    fs: float = 48000.0,
    *,
    force: float = 2.0,
    stops: Mapping[str, int] | None = None,
    outputs: Sequence[str] | None = None,
) -> None:
    """Save an instrument with a pluck of each string, to be played by ``src/embed/saved_model.hpp``.

    path : of the file; conventionally ``.tonewood``.
    instrument : a loaded instrument, or its name or folder.
    fs : Hz, of the steps.
    force : N, of the plucks by the default technique.
    stops : string -> stop at which it is held; open where left out.
    outputs : groups that are read; the first where left out.
    Raises TonewoodError : the rate is not from 1 kHz to 10 MHz, there is no such string or stop, or the technique moves
        more than known forces.
    Raises OutputError : the file cannot be written.
    """
    if not (isinstance(fs, int | float) and LOWEST_FS <= fs <= HIGHEST_FS):
        raise TonewoodError(f"is {fs!r}; {LOWEST_FS:g} to {HIGHEST_FS:g} Hz are allowed", key="fs")
    model = assemble(as_instrument(instrument), fs, outputs=outputs)
    engine = Engine(model, Timeline((), ()))
    stop_of = dict(stops or {})
    if unknown := set(stop_of) - set(model.strings):
        names = ", ".join(model.strings)
        raise TonewoodError(f"there is no string {min(unknown)}; there are {names}", key="stops")
    exciter = model.exciters[model.default_exciter]
    values = {"force": force} if "force" in type(exciter.parameters).model_fields else {}
    plays = []
    changes: dict[str, Compiled] = {}
    for name, string in model.strings.items():
        stop = stop_of.get(name, 0)
        try:
            string.length(stop)
        except (TypeError, ValueError):
            kind = "numbers" if string.stopping.continuous else "whole numbers"
            reason = f"{name} is {stop!r}; {kind} from 0 to {string.tuning.stops.count} are allowed"
            raise TonewoodError(reason, key="stops") from None
        gesture = exciter.gesture(Event(values, string.freq(stop), 1.0, stop), model.place(name, stop))
        if gesture.motions or gesture.on is not None:
            reason = f"{model.default_exciter} moves a partner; plucks by known forces can be saved"
            raise TonewoodError(reason, key="exciter")
        before = engine.frettings[name]
        fretting = engine.fingerboard.playable(
            name, type(before)(float(stop), place=gesture.from_bridge, width=gesture.width)
        )
        changes |= engine.fingerboard.bases(name, fretting)
        plays.append(Play(-gesture.start, gesture, string=name))
    system = engine.system.with_compiled(changes)
    plucks = [forces(play, model, system, 0) for play in plays]
    routing = Routing(model, float(system.dt) ** -1)
    if not routing.plain:
        reason = (
            "a circuit, delays, an equalizer, a single channel with a pan, or channels in another order cannot be saved"
        )
        raise TonewoodError(reason, key="outputs")
    more = {"fs": float(system.dt) ** -1, "scale": routing.scale}
    write_arrays(path, recorded(system, plucks) | flat(more))


def recorded(system: System, plucks: Sequence[Sequence[Injection]] = (), isa: str | None = None) -> Arrays:
    """Arrays of a system and of known forces from sample 0 on. Raises TonewoodError : a law is a function in memory."""
    stepper = KernelStepper(system, isa=isa)
    state = stepper.start()
    description = stepper.describe()
    if description["nonlinear"]["functions"]:
        raise TonewoodError("a law that is a function in memory cannot be saved", key="connections")
    if any("function" in potential for potential in description["potentials"]):
        raise TonewoodError("a potential that is a function in memory cannot be saved", key="potentials")
    description["capacity"] = state.modes.shape[1]
    description["n_channels"] = len(system.readouts)
    description["plucks"] = [stepper.pack_injections(pluck, state.sample) for pluck in plucks]
    return flat(description)


def write_arrays(path: str | os.PathLike[str], arrays: Arrays) -> None:
    """Write named arrays to a file, whole or not at all. Raises OutputError : it cannot be written."""
    file = AtomicFile(Path(path))
    try:
        with file.path.open("wb") as stream:
            stream.write(MAGIC)
            for name, values in arrays.items():
                kind = "f8" if values.dtype.kind == "f" else "i8"
                stream.write(" ".join([name, kind, *map(str, values.shape)]).encode() + b"\n")
                stream.write(values.astype(f"<{kind}").tobytes())
        file.complete()
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from None
    finally:
        file.discard()


def flat(value: Any, path: str = "") -> Arrays:
    """Arrays and numbers in nested mappings and sequences, by their paths; lists of numbers are arrays."""
    entries: Iterable[tuple[Any, Any]]
    if isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, Sequence) and not (
        isinstance(value, list) and all(isinstance(x, int | float) for x in value)
    ):
        entries = enumerate(value)
    else:
        return {path: np.asarray(value, dtype=int if isinstance(value, list) and not value else None)}
    return {k: a for key, inner in entries for k, a in flat(inner, f"{path}/{key}" if path else str(key)).items()}
