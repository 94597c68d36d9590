"""Nonlinear systems that methods are compared on: rising tension, strings against obstacles, a hardening mounting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from tonewood.lab.accuracy.runs import KernelRun, Scene
from tonewood.lab.assembled import integrated
from tonewood.lab.methods.problem import Problem, inverses
from tonewood.lab.string_end import ExactString
from tonewood.lab.systems import klosner_problems, string_and_body
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply
from tonewood.support.arrays import Floats

#: steel string: density 8050 kg/m^3, radius .3556 mm, 75 N, 174 GPa, 1 m; its EA, N
STEEL = ExactString(1.0, 75.0, 8050 * np.pi * 0.3556e-3**2, 174e9 * np.pi * 0.3556e-3**4 / 4)
STEEL_EA = 174e9 * np.pi * 0.3556e-3**2


@dataclass(frozen=True, eq=False)
class Truth:
    """Displacements (n,) that methods are held against, and in words where they come from."""

    wave: Floats
    source: str


@dataclass(frozen=True, eq=False)
class NonlinearCase:
    """A nonlinear system of real modes, let go from a state.

    name, title : short, and as a heading.
    scene : problem of one read point, laws, tensions, and the state.
    duration : s that waveforms are compared over.
    rates, verlet_rates : Hz.
    lossless : whether its energy should stay.
    slow : whether the integrator of order 8 takes more than seconds.
    pitch : closed form of the fundamental, Hz; it is compared instead of waveforms where it is not 0.
    """

    name: str
    title: str
    scene: Scene
    duration: float
    rates: tuple[float, ...]
    verlet_rates: tuple[float, ...]
    lossless: bool = True
    slow: bool = True
    pitch: float = 0.0

    @property
    def reference_rate(self) -> float:
        """Rate at which waveforms are compared, Hz."""
        return float(min(self.rates))

    @property
    def fine_rate(self) -> float:
        """32 times the rate of a render, or of the lowest that is tried."""
        return 32 * min(48e3, 2 * self.reference_rate)

    def integrated(self) -> Truth:
        """Motion by an integrator of order 8, and how far the project's scheme at a high rate is from it."""
        a, rtol = self.scene.arrays, 1e-11
        q, v = apply(a.modes.read, self.scene.x).T
        n = len(q)
        # velocities in units of the frequency: entries of one size
        scale = np.sqrt(np.maximum(a.modes.omega2, a.modes.omega2[a.modes.omega2 > 0].min()))

        def rate(t: float, y: Floats) -> Floats:
            v = y[n:] * scale
            return np.concatenate([v, a.acceleration(y[:n], v) / scale])

        start = np.concatenate([q, v / scale])
        times = np.asarray(
            np.arange(round(self.duration * self.reference_rate)) / self.reference_rate, dtype=np.float64
        )
        y = (
            integrated(rate, start, times, rtol=rtol, atol=rtol * 1e-2 * float(np.abs(start).max()))[:, :n]
            @ a.modes.outs[0]
        )
        far = float(sla.norm(self._fine(1)[: len(y)] - y) / sla.norm(y))
        return Truth(y, f"DOP853, rtol 1e-11 (tonewood at {self.fine_rate / 1e3:g} kHz: {far:.1e} from it)")

    def stepped(self) -> Truth:
        """Motion by the project's scheme at a high rate, and its distance from its limit: it is of order 2."""
        fine, coarse = self._fine(1), self._fine(2)
        far = float(sla.norm(fine - coarse) / sla.norm(fine)) / 3
        return Truth(fine, f"tonewood at {self.fine_rate / 1e3:g} kHz, converged to {far:.1e}")

    def _fine(self, divisor: int) -> Floats:
        rate = self.fine_rate / divisor
        run = KernelRun(self.scene, rate, residual=False)
        return run.run(round(self.duration * rate), round(rate / self.reference_rate))[0][:, 0]


def plucked_steel(force: float = 2.0, freq_upper: float = 10000.0) -> Scene:
    """A lossless steel string of rising tension on 16 guitar modes without damping, plucked at a fifth (N)."""
    body = string_and_body.sixteen_modes()
    still = ModalBasis.real(np.sqrt(body.stiffness), np.zeros(16), {"bridge": body.right[0].real})
    string = STEEL.basis({"pluck": 0.2}, freq_upper=freq_upper)
    pluck = (Term("string", "pluck"),)
    problem = Problem({"string": string, "body": still}, (string_and_body.BRIDGE,), pluck, pluck)
    tension = TensionModulation("string", ("string",), STEEL_EA)
    return Scene(problem, problem.static(np.array([force])), tensions=(tension,))


def tension_case() -> NonlinearCase:
    """A lossless steel string on 16 guitar modes without damping, plucked with 2 N at a fifth: tension rises by 5 %."""
    return NonlinearCase(
        "tension",
        "Steel string whose tension rises, on 16 guitar modes",
        plucked_steel(),
        0.2,
        (24e3, 48e3, 96e3, 192e3, 384e3),
        (48e3, 96e3, 192e3, 384e3, 768e3),
    )


def _against_obstacle(contact: Contact) -> Scene:
    """An ideal string lifted by 2 mm at its middle, with an obstacle there at rest level."""
    string, middle = string_and_body.A2, (Term("string", "middle"),)
    basis = string.basis({"middle": 0.5, "pickup": 0.3}, freq_upper=20000.0)
    wall = Connection("wall", (Term("string", "bridge"),))
    problem = Problem({"string": basis}, (wall,), middle, (Term("string", "pickup"),))
    x = problem.static(np.array([2e-3 * 4 * string.tension / string.length]))
    return Scene(problem, x, (Connection("obstacle", middle, contact),))


def obstacle_case() -> NonlinearCase:
    """Against an obstacle like a felted one: 1e10 p^2.3, smooth enough for waveforms to be compared for 40 ms."""
    return NonlinearCase(
        "obstacle",
        "Ideal string against an obstacle at its middle, 1e10 p^2.3",
        _against_obstacle(Contact(1e10, 2.3)),
        0.04,
        (48e3, 96e3, 192e3, 384e3),
        (96e3, 192e3, 384e3, 768e3, 1536e3),
    )


def hard_obstacle_case() -> NonlinearCase:
    """Against an all but rigid obstacle, 1e10 N/m: in truth the period is exactly three quarters of the free one."""
    return NonlinearCase(
        "hard_obstacle",
        "Ideal string against a hard obstacle at its middle, 1e10 N/m",
        _against_obstacle(Contact(1e10, 1.0)),
        0.3,
        (48e3, 96e3, 192e3),
        (19.2e6, 76.8e6),
        pitch=4 / 3 * string_and_body.A2.fundamental,
    )


def klosner_case() -> NonlinearCase:
    """Klosner & Ranlet's problem D, let go with the beam bent by 5 N and the chain following it as a whole."""
    problem_d = klosner_problems.problem_d()
    parts = klosner_problems.components(problem_d, "free-free")
    assert problem_d.mounting is not None
    mount = Connection("mount", (Term("main", "seat"), Term("sub", "foot", -1.0)), problem_d.mounting)
    seat = (Term("main", "seat"),)
    problem = Problem(parts, (Connection("seat", (Term("main", "seat", 0.0),)),), seat, seat)
    m, beam, sub = problem.real, problem.starts["main"], parts["sub"]
    q = np.where(m.omega2 > 0, m.outs[0] * 5.0 / np.where(m.omega2 > 0, m.omega2, 1.0), 0.0)
    rigid = int(np.argmin(sub.stiffness))
    q[problem.starts["sub"]] = 0.0
    level = float(m.outs[0, beam] @ q[beam])
    q[problem.starts["sub"].start + rigid] = level / float(sub.right[sub.index("foot"), rigid].real)
    return NonlinearCase(
        "klosner_d",
        "Klosner & Ranlet's problem D: beam, hardening mounting with dashpots, two masses",
        Scene(problem, apply(inverses(m.read), np.stack([q, np.zeros_like(q)], axis=-1)), (mount,)),
        1.0,
        (500.0, 1e3, 2e3, 4e3, 8e3),
        (500.0, 1e3, 2e3, 4e3, 8e3, 16e3),
        lossless=False,
        slow=False,
    )
