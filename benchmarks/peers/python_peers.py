"""Peers that are Python packages: run by `run.py` with the interpreter that has them.

    python python_peers.py NAME SECONDS < modes.json      prints processor time and rms of the sound

NAME is jaxdiffmodal, jaxdiffmodal-tension or genny; modes.json has freq (Hz), decay (1/s) and gain of each mode.
Code that is compiled on first use is compiled before the clock starts.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np


def jaxdiffmodal(modes: dict[str, Any], seconds: float, tension: float) -> Any:
    """Stoermer-Verlet in 64-bit numbers, all modes in one scan; `tension` scales the cubic term of their sum."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from jaxdiffmodal import time_integrators as ti

    omega = 2 * np.pi * np.array(modes["freq"])
    gain = jnp.array(modes["gain"])
    weights = jnp.array(np.arange(1, len(omega) + 1.0) ** 2)
    law = ti.make_tm_nl_fn(tension * weights, jnp.ones((len(omega), 1)) * weights[None, :]) if tension else _nothing
    force = jnp.zeros((round(48000 * seconds), len(omega))).at[0].set(gain)

    @jax.jit
    def sound(force: Any) -> Any:
        damping, stiffness = 2 * jnp.array(modes["decay"]), jnp.array(omega**2)
        return ti.solve_sv_excitation(damping, stiffness, force, 1 / 48000, law)[1].sum(axis=1)

    sound(force).block_until_ready()
    return lambda: np.asarray(sound(force).block_until_ready())


def _nothing(q: Any) -> Any:
    return 0.0 * q


def genny(modes: dict[str, Any], seconds: float, tension: float) -> Any:
    """Its bank of modes under one impulse."""
    from genny import physics

    made = physics._modal.Modes(*(np.array(modes[key]) for key in ("freq", "decay", "gain")), "vdd")
    force = np.zeros(round(physics._PHYS_SR * seconds))
    force[0] = 1.0
    physics._modal.render_modes(force[:1000], made)
    return lambda: physics._modal.render_modes(force, made)


def main() -> None:
    """Time one peer."""
    name, seconds = sys.argv[1], float(sys.argv[2])
    modes = json.load(sys.stdin)
    make = genny if name == "genny" else jaxdiffmodal
    play = make(modes, seconds, 1e10 if name.endswith("tension") else 0.0)
    began = time.process_time()
    sound = play()
    print(time.process_time() - began, float(np.sqrt(np.mean(sound**2))))


if __name__ == "__main__":
    main()
