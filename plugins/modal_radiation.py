"""Microphones as a one-way bank of modes, driven by the forces of the strings on the bridge.

    p(s) = sum_i (H_heave + u_i H_moment) F_i,    H = sum_k R_k / (s - p_k) + conj.,    p = -pi f / Q + 2 pi i f

F_i is the force on the body at the bridge place u_i (-1 bass end .. +1 treble end). Nothing acts back on the body.
With `driven_by: points` every driven point of the body has a response of its own, H_i in place of that sum.

The table has columns ``f_Hz, Q`` and per channel ``NAME_re, NAME_im, NAME_moment_re, NAME_moment_im``, Pa/N; with
`driven_by: points` ``NAME_at_POINT_re, NAME_at_POINT_im`` per channel and point. With
`residue_fs` they are the residues of a discrete bank sum R / (1 - exp(p / residue_fs) / z) fitted at that rate; the
continuous bank used here, residues R p / (exp(p / residue_fs) - 1), gives the same numbers back at that rate when its
force is held over a sample, and R (exp(p h) - 1) / (exp(p / residue_fs) - 1) at any other. Without it they are the
continuous ones, Pa/(N s).

A fit is not valid below its range, where its modes add up to a pressure that follows a slowly growing force, unlike
that of air. With `low_cut` the bank is that of H(s) s^2 / ((s + a) (s + b)), a and b a quarter
below and above the cut: residues times that factor at each pole, and two real modes more per input,

    H(-a) a^2 / ((b - a) (s + a))   and   H(-b) b^2 / ((a - b) (s + b)).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class ModalRadiationParameters(Parameters):
    """Parameters of the microphones."""

    table: str = ta.described("CSV file in the bundle")
    channels: list[str] = ta.described("names of the microphones to use, as in the table's columns", min_length=1)
    driven_by: Literal["bridge_forces", "points"] = ta.described(
        "bridge_forces: heave and moment of the forces on the bridge; points: the force at each point of the body",
        default="bridge_forces",
    )
    force_sign: Literal[1, -1] = ta.described(
        "1 if the table counts a force out of the soundboard (+z) as positive, -1 if into it", default=1
    )
    residue_fs: float | None = ta.quantity("Hz", low=1e3, default=None, doc="rate of a discrete fit")
    moved_modes: list[ta.MovedMode] = ta.described("modes of the table with another frequency and Q", default=[])
    low_cut: float | None = ta.quantity(
        "Hz", low=1.0, high=200.0, default=None, doc="second-order high-pass below the range of the fit"
    )


class ModalRadiation(ta.Microphones[ModalRadiationParameters]):
    """The microphones; see the module."""

    api = 1
    Parameters = ModalRadiationParameters

    @property
    def channels(self) -> tuple[str, ...]:
        """The microphones."""
        return tuple(self.parameters.channels)

    def rows(self, name: str, scene: ta.Scene) -> ta.PickupRows:
        """A component `name` with inputs ``heave`` and ``moment``, or one a point, and an output per channel."""
        sign, coordinates = float(self.parameters.force_sign), {}
        if self.parameters.driven_by == "points":
            driven, drives, inputs = self.at_points(name, scene, sign)
            return self.bank_rows(name, self.basis(scene.freq_upper, driven), drives, inputs)
        for point, body_point in scene.body_points.items():
            if "u" in body_point.coordinates:
                coordinates[point] = (body_point.coordinates.get("heave", 1.0), body_point.coordinates["u"])
        drives = []
        for force in scene.bridge_forces:
            if force.point not in coordinates:
                raise self.fault(f"the body's point {force.point!r} has no place u on the bridge")
            heave, u = coordinates[force.point]
            if abs(u) > 1.0:
                raise self.fault(f"the body's point {force.point!r} lies at u = {u:g}; -1 to 1 are allowed")
            factor = sign * force.factor
            drives.append(ta.Drive(name, "heave", force.connection, factor * heave))
            drives.append(ta.Drive(name, "moment", force.connection, factor * u))
        inputs = {
            point: ((name, "heave", sign * heave), (name, "moment", sign * u))
            for point, (heave, u) in coordinates.items()
        }
        return self.bank_rows(name, self.basis(scene.freq_upper), drives, inputs)

    def basis(self, freq_upper: float, driven: Sequence[str] = ()) -> ta.ModalBasis:
        """Modes below `freq_upper` (Hz), once for each channel.

        Points ``heave`` and ``moment``, or ``at_POINT`` of each of the body's points `driven`, take forces (N), the
        channels give pressure (Pa).
        """
        p = self.parameters
        table = self.files.table(p.table, f"{self.key}.table")
        columns = {f"at_{point}": f"_at_{point}" for point in driven} or {"heave": "", "moment": "_moment"}
        heads = ["f_Hz", "Q"] + [f"{c}{m}_{x}" for c in p.channels for m in columns.values() for x in ("re", "im")]
        missing = [name for name in heads if name not in table]
        if missing:
            raise self.fault(f"{p.table}: no column {missing[0]!r}; there are {', '.join(table)}", "table")
        if np.any(table["f_Hz"] <= 0) or np.any(table["Q"] <= 0):
            raise self.fault(f"{p.table}: f_Hz and Q must be above 0", "table")
        try:
            freq, quality = ta.with_moved_modes(table["f_Hz"], table["Q"], p.moved_modes)
        except ValueError as fault:
            raise self.fault(f"{p.table}: {fault}", "moved_modes") from None
        keep = freq < freq_upper
        freq, quality = freq[keep], quality[keep]
        poles = np.pi * freq * (-1 / quality + 2j)
        gain = np.ones_like(poles) if p.residue_fs is None else poles / np.expm1(poles / p.residue_fs)
        residues = {
            (c, point): (table[f"{c}{m}_re"] + 1j * table[f"{c}{m}_im"])[keep] * gain
            for c in p.channels
            for point, m in columns.items()
        }
        if p.low_cut is not None:
            residues = {key: cut_low(poles, np.asarray(r), p.low_cut) for key, r in residues.items()}
            poles = np.concatenate([poles, -_cut_rates(p.low_cut)])
        # each channel has modes of its own, so that the modes of channels that are not recorded are not stepped
        banks = {c: np.array([residues[c, point] for point in columns]) for c in p.channels}
        heard = {c: bank.any(axis=0) for c, bank in banks.items()}
        owner = np.repeat(list(heard), [np.count_nonzero(mask) for mask in heard.values()])
        left = dict(zip(columns, np.hstack([banks[c][:, heard[c]] for c in p.channels]), strict=True))
        right = {c: (owner == c).astype(np.complex128) for c in p.channels}
        none = np.zeros(len(owner), dtype=np.complex128)
        inputs, outputs = dict.fromkeys(left, none), dict.fromkeys(right, none)
        every = np.concatenate([poles[heard[c]] for c in p.channels])
        return ta.ModalBasis.complex(every, inputs | right, left | outputs)


def _cut_rates(freq: float) -> NDArray[np.float64]:
    """Rates a and b of the high-pass, 1/s."""
    return 2 * np.pi * freq * np.array([0.8, 1.25])


def cut_low(poles: NDArray[np.complex128], residues: NDArray[np.complex128], freq: float) -> NDArray[np.complex128]:
    """Residues of H(s) s^2 / ((s + a) (s + b)): of the poles of H, then of -a and -b.

    Parameters
    ----------
    poles, residues : (n,) of H, one of each conjugate pair.
    freq : Hz, a and b are 0.8 and 1.25 times 2 pi freq.
    """
    a, b = _cut_rates(freq)
    at = [float(np.sum(2 * (residues / (-rate - poles)).real)) for rate in (a, b)]
    real = np.array([at[0] * a**2 / (b - a), at[1] * b**2 / (a - b)])
    return np.concatenate([residues * poles**2 / ((poles + a) * (poles + b)), real])
