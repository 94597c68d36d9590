"""The nonlinear systems: a tension-modulated string, strings against obstacles, a beam with a hardening mounting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonewood.lab.accuracy.nonlinear import NonlinearCase
from tonewood.lab.methods.problem import Problem, inverses
from tonewood.lab.string_end import ExactString
from tonewood.lab.systems import klosner_problems, string_and_body
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply
from tonewood.physics.modal.string_modes import string_basis

Floats = NDArray[np.float64]

#: steel string: density 8050 kg/m^3, radius .3556 mm, 75 N, 174 GPa, 1 m
STEEL = ExactString(1.0, 75.0, 8050 * np.pi * 0.3556e-3**2, 174e9 * np.pi * 0.3556e-3**4 / 4)
STEEL_EA = 174e9 * np.pi * 0.3556e-3**2


def _string(string: ExactString, freq_upper: float, places: dict[str, float]) -> ModalBasis:
    basis = string_basis(
        string.length, string.tension, string.linear_density, string.bending_stiffness,
        lambda omega, k: np.zeros_like(omega), freq_upper=freq_upper,
    )  # fmt: skip
    return basis.with_places(places)


def tension_case() -> NonlinearCase:
    """A lossless steel string on 16 guitar modes without damping, plucked with 2 N at a fifth: tension rises by 5 %."""
    body = string_and_body.sixteen_modes()
    still = ModalBasis.real(np.sqrt(body.stiffness), np.zeros(16), {"bridge": body.right[0].real})
    components = {"string": _string(STEEL, 10000.0, {"pluck": 0.2 * STEEL.length}), "body": still}
    bridge = Connection("bridge", (Term("string", "bridge"), Term("body", "bridge", -1.0)))
    problem = Problem(components, (bridge,), (Term("string", "pluck"),), (Term("string", "pluck"),))
    return NonlinearCase(
        "tension",
        "Steel string whose tension rises, on 16 guitar modes",
        problem,
        (),
        (TensionModulation("string", ("string",), STEEL_EA),),
        0.2,
        (24e3, 48e3, 96e3, 192e3, 384e3),
        (48e3, 96e3, 192e3, 384e3, 768e3),
        True,
        lambda flat: flat.static(np.array([2.0])),
    )


def _against_obstacle(contact: Contact) -> tuple[Problem, Connection, float]:
    """An ideal string with an obstacle at its middle, at rest level; and the force that lifts it there by 2 mm."""
    string = string_and_body.A2
    basis = _string(string, 20000.0, {"middle": 0.5 * string.length, "pickup": 0.3 * string.length})
    wall = Connection("wall", (Term("string", "bridge"),))
    touch = Connection("obstacle", (Term("string", "middle"),), contact)
    problem = Problem({"string": basis}, (wall,), (Term("string", "middle"),), (Term("string", "pickup"),))
    return problem, touch, 2e-3 * 4 * string.tension / string.length


def obstacle_case() -> NonlinearCase:
    """Against an obstacle like a felted one: 1e10 p^2.3, smooth enough for waveforms to be compared for 40 ms."""
    problem, touch, force = _against_obstacle(Contact(1e10, 2.3))
    return NonlinearCase(
        "obstacle",
        "Ideal string against an obstacle at its middle, 1e10 p^2.3",
        problem,
        (touch,),
        (),
        0.04,
        (48e3, 96e3, 192e3, 384e3),
        (96e3, 192e3, 384e3, 768e3, 1536e3),
        True,
        lambda flat: flat.static(np.array([force])),
    )


def hard_obstacle_case() -> NonlinearCase:
    """Against an all but rigid obstacle, 1e10 N/m: in truth the period is exactly three quarters of the free one."""
    problem, touch, force = _against_obstacle(Contact(1e10, 1.0))
    return NonlinearCase(
        "hard_obstacle",
        "Ideal string against a hard obstacle at its middle, 1e10 N/m",
        problem,
        (touch,),
        (),
        0.3,
        (48e3, 96e3, 192e3),
        (19.2e6, 76.8e6),
        True,
        lambda flat: flat.static(np.array([force])),
        pitch=4 / 3 * string_and_body.A2.fundamental,
    )


def klosner_case() -> NonlinearCase:
    """Klosner & Ranlet's problem D, let go with the beam bent by 5 N and the chain following it."""
    given = klosner_problems.problem_d()
    parts = klosner_problems.components(given, "free-free")
    assert given.mounting is not None
    mount = Connection("mount", (Term("main", "seat"), Term("sub", "foot", -1.0)), given.mounting)
    seat = Connection("seat", (Term("main", "seat", 0.0),))
    problem = Problem(parts, (seat,), (Term("main", "seat"),), (Term("main", "seat"),))

    def bent(flat: Problem) -> Floats:
        """Beam at rest under 5 N; the chain displaced as a whole by as much as its seat."""
        x = np.zeros((flat.n_modes, 2))
        m = flat.real
        q = np.where(m.omega2 > 0, m.outs[0] * 5.0 / np.where(m.omega2 > 0, m.omega2, 1.0), 0.0)
        beam = flat.starts["main"]
        level = float(m.outs[0, beam] @ q[beam])
        sub = parts["sub"]
        rigid = int(np.argmin(sub.stiffness))
        q[flat.starts["sub"]] = 0.0
        q[flat.starts["sub"].start + rigid] = level / float(sub.right[sub.index("foot"), rigid].real)
        x[:] = apply(inverses(m.read), np.stack([q, np.zeros_like(q)], axis=-1))
        return x

    return NonlinearCase(
        "klosner_d",
        "Klosner & Ranlet's problem D: beam, hardening mounting with dashpots, two masses",
        problem,
        (mount,),
        (),
        1.0,
        (500.0, 1e3, 2e3, 4e3, 8e3),
        (500.0, 1e3, 2e3, 4e3, 8e3, 16e3),
        False,
        bent,
        slow=False,
    )
