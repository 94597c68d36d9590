"""Small systems with every kind of component and connection, saved: tests of the reader of saved models damage them."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import patch

import numpy as np

from tonewood.physics.coupling import elimination
from tonewood.physics.coupling.connections import Connection, Law, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.inverse import InverseInParts
from tonewood.physics.coupling.laws import Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Injection, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.sound.render.model_file import recorded, save_model, write_arrays

LENGTH, TENSION, DENSITY, AXIAL, FS = 0.65, 70.0, 3.6e-3, 2e4, 16000.0
PLACES = {"pluck": 0.08, "a": 0.2, "b": 0.3, "c": 0.4}
FRET = Contact(1e6, 1.5, loss=0.1, offset=-1e-5)
LAWS: dict[str, Law] = {
    "contact": Contact(1e6, 1.5, loss=0.1, offset=1e-6),
    "spring": HardeningSpring(1e3, cubic=1e9, damping=0.1, quadratic_damping=0.01),
    "sampled": SampledPotential.from_force([-3e-4, -1e-4, 2e-4], [2.0, 0.1, 0.0], damping=0.05),
    "friction": Friction(0.3, velocity=0.05),
}


def _string(tension: float = TENSION, n_modes: int = 6) -> ModalBasis:
    basis = string_basis(LENGTH, tension, DENSITY, 0.0, lambda w, k: 2.0 + 0.0 * w, n_modes=n_modes)
    return basis.with_places(PLACES)


def _body(n_points: int) -> ModalBasis:
    rng = np.random.default_rng(1)
    omega = 2 * np.pi * np.geomspace(90.0, 3000.0, 10 + n_points)
    return ModalBasis.real(omega, 0.01 * omega, {f"b{i}": rng.normal(size=len(omega)) for i in range(n_points)})


def _joint(string: str, point: str) -> Connection:
    return Connection(f"joint_{string}", (Term(string, "bridge"), Term("body", point, -1.0)), Rigid())


def _strings(n: int) -> tuple[dict[str, ModalBasis], list[Connection], list[Readout]]:
    """`n` strings on a body."""
    names = [f"s{i}" for i in range(n)]
    components = {name: _string(TENSION * 1.1**i) for i, name in enumerate(names)} | {"body": _body(n)}
    readouts = [
        Readout("air", "acceleration", (Term("body", "b0"),)),
        Readout("force", "force", (), ((f"joint_{names[-1]}", 1.0),)),
    ]
    return components, [_joint(name, f"b{i}") for i, name in enumerate(names)], readouts


def _system(name: str) -> System:
    components, connections, readouts = _strings({"in parts": 8, "many ports": 17}.get(name, 2))
    build = {}
    if name == "contacts":
        connections += [Connection(f"fret_{p}", (Term("s0", p),), FRET) for p in "abc"]
    if name in LAWS or name == "laws":
        laws = LAWS if name == "laws" else {name: LAWS[name]}
        for place, (key, law) in zip("abca", laws.items(), strict=False):
            connections.append(Connection(key, (Term("s0", place), Term("s1", place, -1.0)), law))
            connections.append(Connection(f"foam_{key}", (Term("s0", place),), SpringDashpot(10.0, 0.1)))
    if name in ("tension", "tension and contacts"):
        build["potentials"] = [TensionModulation("s0", ("s0",), AXIAL), TensionModulation("s1", ("s1",), AXIAL)]
        if name != "tension":
            connections += [Connection(f"fret_{p}", (Term("s0", p),), FRET) for p in "ab"]
            connections.append(Connection("bow", (Term("s1", "c"),), LAWS["friction"]))
    if name == "longitudinal":
        components["x"] = string_basis(LENGTH, AXIAL, DENSITY, 0.0, lambda w, k: 5.0 + 0.0 * w, n_modes=1)
        connections.append(Connection("joint_x", (Term("x", "bridge"),), Rigid()))
        build["potentials"] = [GeometricStretch("string", ("s0",), "x", AXIAL, 3000.0)]
    if name == "phantoms":
        build["potentials"] = [DrivenLongitudinal("string", ("s0",), (("body", "b1", 1.0),), AXIAL, 5000.0, 2e-3)]
    return System.build(components, connections, readouts, dt=1 / FS, **build)


NAMES = (
    "linear", "in parts", "many ports", "contacts", *LAWS, "laws", "tension", "tension and contacts", "longitudinal",
    "phantoms",
)  # fmt: skip


def write_small_models(folder: Path) -> list[Path]:
    """Write a file of each system, with a force on its first component, and a saved instrument."""
    files = []
    for name in NAMES:
        with patch.multiple(elimination, LEAST_IN_PARTS=6 if name == "in parts" else 1000, MOST_IN_PART=4):
            system = _system(name)
            assert isinstance(system.solve.by, InverseInParts) == (name == "in parts")
            first = system.names[0]
            vectors = system.compiled[0].W[-1:]
            pluck = [Injection(first, 3, vectors, np.full((1, 40), 2.0))]
            arrays = recorded(system, [pluck], isa="baseline")
        files.append(folder / f"{name.replace(' ', '_')}.tonewood")
        write_arrays(files[-1], arrays | {"fs": np.array(FS), "scale": np.ones(2)})
    files.append(folder / "instrument.tonewood")
    save_model(files[-1], "monochord", 4000.0)
    return files
