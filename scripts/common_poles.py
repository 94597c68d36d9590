"""Fit both tables of a measured guitar with common poles: ``python scripts/common_poles.py [BUNDLE] [PICTURE]``.

Mobility and microphones of the measured guitars were fitted apart, and their poles differ. The measurement itself is
not at hand, so the frequency responses are made from the two tables, and one set of poles is fitted to all of them:
mobility with real residues, pressure with complex ones (`tonewood.workshop.fit.projection`). Printed are the main
modes in both tables and in the common fit, and the misfit, re the r.m.s. of each band.
"""

from __future__ import annotations

import sys
from itertools import pairwise

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import list_instruments
from tonewood.workshop.fit.projection import FitData, Poles, Projection, Shape

Complexes = NDArray[np.complex128]

BODY, MICROPHONES = ("heave", "cross", "rock"), ("treble", "bass", "upper")
FROM, TO, FS = 70.0, 10e3, 48000
BANDS = (70, 150, 300, 700, 1500, 3000, 10000)
TURNS, TOLERANCE = 30, 1e-3


def tables(bundle: str) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """Mobility's and microphones' table of a bundle."""
    files = Files(list_instruments()[bundle])
    return files.table("body.csv", "body"), files.table("radiation.csv", "outputs")


def grid() -> NDArray[np.float64]:
    """Frequencies, Hz: 0.7 Hz apart, 1/500 of the frequency where that is more."""
    out = [FROM]
    while out[-1] < TO:
        out.append(out[-1] + max(0.7, out[-1] / 500))
    return np.array(out)


def responses(
    body: dict[str, NDArray[np.float64]], heard: dict[str, NDArray[np.float64]], s: Complexes
) -> list[Complexes]:
    """(3, N) mobility, (m/s)/N, and (6, N) pressure, Pa/N, of the tables."""
    w = 2 * np.pi * body["f_Hz"][:, None]
    mobility = np.array([body[k] for k in BODY]) @ (s / (s * s + w / body["Q"][:, None] * s + w * w))
    pole = np.pi * heard["f_Hz"] * (-1 / heard["Q"] + 2j)
    names = [f"{m}{part}" for part in ("", "_moment") for m in MICROPHONES]
    residues = np.array([heard[f"{n}_re"] + 1j * heard[f"{n}_im"] for n in names]) * pole / np.expm1(pole / FS)
    pressure = residues @ (1 / (s - pole[:, None])) + residues.conj() @ (1 / (s - pole.conj()[:, None]))
    return [mobility, pressure]


def started(body: dict[str, NDArray[np.float64]], heard: dict[str, NDArray[np.float64]]) -> Poles:
    """Poles of the microphones, means where one of the body's lies in the same third of a bandwidth, and its others."""
    freq, quality, met = heard["f_Hz"].copy(), heard["Q"].copy(), set[int]()
    others = []
    for f, q in zip(body["f_Hz"], body["Q"], strict=True):
        width = np.maximum(f / q, heard["f_Hz"] / heard["Q"])
        off = np.abs(heard["f_Hz"] - f)
        near = [
            i for i in np.flatnonzero((off < 0.35 * width) & (np.abs(np.log(heard["Q"] / q)) < 0.9)) if i not in met
        ]
        if near:
            i = min(near, key=off.__getitem__)
            met.add(int(i))
            freq[i], quality[i] = (freq[i] + f) / 2, np.sqrt(quality[i] * q)
        else:
            others.append((f, q))
    more = np.array(others).reshape(-1, 2)
    return Poles.at(np.append(freq, more[:, 0]), np.append(quality, more[:, 1]))


def fitted(problems: list[Projection], poles: Poles) -> Poles:
    """Poles with the least sum of both misfits, by Levenberg and Marquardt's steps."""
    found = [p.solve(poles, slopes=True) for p in problems]
    cost, damping, k = sum(f.cost for f in found), 1e-2, len(poles)
    for _ in range(TURNS):
        normal, gradient = sum(f.normal for f in found), sum(f.gradient for f in found)
        scale = np.diag(normal) + 1e-6 * np.diag(normal).max()
        step = np.clip(sla.pinvh(normal + damping * np.diag(scale)) @ gradient, -0.2, 0.2)
        zeta = np.clip(poles.log_zeta + step[k:], np.log(0.5 / 120), np.log(0.5 / 2.5))
        tried = Poles(poles.log_freq + step[:k], zeta)
        again = [p.solve(tried, slopes=True) for p in problems]
        new = sum(f.cost for f in again)
        if new >= cost:
            damping *= 5
            continue
        converged = (cost - new) < TOLERANCE * cost
        poles, found, cost, damping = tried, again, new, max(damping / 3, 1e-6)
        if converged:
            break
    return poles


def main(bundle: str, picture: str | None) -> None:
    """Fit, print and draw."""
    body, heard = tables(bundle)
    freq = grid()
    measured = responses(body, heard, 2j * np.pi * freq)
    problems = []
    for rows, shape in zip(
        measured, (Shape((0,), 3, False, False, False), Shape((), 6, True, False, False)), strict=True
    ):
        local = np.sqrt(uniform_filter1d(np.abs(rows) ** 2, 61, axis=1))
        floor = 0.02 * np.abs(rows[0]) + 1e-3 * np.abs(rows).max(axis=1, keepdims=True)
        sigma = 0.2 * np.sqrt((local**2 + np.abs(rows) ** 2) / 2) + floor
        problems.append(Projection(FitData(freq, rows, sigma), shape))
    poles = fitted(problems, started(body, heard))
    models = [p.model(poles, p.solve(poles).residues) for p in problems]
    print(f"{bundle}: {body['f_Hz'].size} and {heard['f_Hz'].size} modes; common: {len(poles)}")
    print("modes below 450 Hz, Hz (Q)")
    for title, f, q in (("mobility", body["f_Hz"], body["Q"]), ("microphones", heard["f_Hz"], heard["Q"]),
                        ("common", np.sort(poles.freq), poles.quality[np.argsort(poles.freq)])):  # fmt: skip
        print(f"  {title:12s}" + ", ".join(f"{a:.1f} ({b:.1f})" for a, b in zip(f, q, strict=True) if a < 450))
    print("misfit of the common fit, re r.m.s.:  mobility  pressure")
    for low, high in pairwise(BANDS):
        inside = (freq >= low) & (freq < high)
        left = [sla.norm((m - r)[:, inside]) / sla.norm(r[:, inside]) for m, r in zip(models, measured, strict=True)]
        print(f"  {low:5d} to {high:5d} Hz  {left[0]:18.3f} {left[1]:9.3f}")
    if picture is not None:
        figure, axes = plt.subplots(1, 2, figsize=(12, 3.4), layout="constrained")
        for axis, table, common, title in zip(
            axes, measured, models, ("mobility, heave", "pressure, treble"), strict=True
        ):
            axis.plot(freq, 20 * np.log10(np.abs(table[0])), label="its own table")
            axis.plot(freq, 20 * np.log10(np.abs(common[0])), "--", label="common poles")
            axis.set(xlim=(70, 1000), xlabel="Hz", ylabel="dB", title=f"{bundle}: {title}")
            axis.legend()
        figure.savefig(picture, dpi=70)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "classical_guitar", sys.argv[2] if len(sys.argv) > 2 else None)
