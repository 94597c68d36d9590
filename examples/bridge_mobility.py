"""Look into a body: its modes, and its mobility where a string ends.

python examples/bridge_mobility.py
"""

from __future__ import annotations

import numpy as np

import tonewood as tw
import tonewood.authoring as ta


def main() -> tuple[float, float]:
    """Frequency (Hz) and size ((m/s)/N) of the strongest peak below 150 Hz under the sixth string."""
    body = tw.load_instrument("classical_guitar").body.basis(freq_upper=10000.0)
    freq = np.linspace(40.0, 150.0, 1101)
    mobility = np.abs(body.frf(freq, "bridge_E2", "bridge_E2", "mobility"))
    peak = int(np.argmax(mobility))
    print(f"{body.n_modes} modes; air resonance at {freq[peak]:.1f} Hz: {mobility[peak]:.3f} (m/s)/N")

    # a basis of one's own: two modes of a plate, driven and read at two places
    plate = ta.ModalBasis.real(
        natural_freq_rad=2 * np.pi * np.array([180.0, 410.0]),
        damping_rate=np.array([9.0, 20.0]),
        points={"bridge": np.array([1.0, 0.6]), "edge": np.array([0.4, -0.8])},
        modal_mass=np.array([0.12, 0.09]),
    )
    print(f"plate: {abs(plate.frf(180.0, 'edge', 'bridge', 'mobility')[0]):.3f} (m/s)/N from bridge to edge at 180 Hz")
    return float(freq[peak]), float(mobility[peak])


if __name__ == "__main__":
    main()
