"""Fit measured files by ``tonewood fit`` and by sdypy-EMA: ``python scripts/fit_peers.py FOLDER``.

FOLDER holds files of others, as far as they are at hand; those missing are left out. The table on
``docs/measured_by_others.md`` is this script's. ``pip install sdypy-EMA`` first. sdypy-EMA (LSCF, order up to 60, then
least squares in the frequency domain with both residual terms) leaves the choice of poles to a person: it is given the
frequencies of tonewood's modes of the band, and takes the stable pole nearest to each.
"""

from __future__ import annotations

import contextlib
import io
import sys
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import Fit, fit_responses
from tonewood.workshop.fit.responses import Responses

#: Hz, upper end of a band below which frequencies are multiplied for sdypy-EMA
LOWEST = 50.0


@dataclass(frozen=True)
class Measured:
    """Files of one body (a pattern of names), how they are read, and their band."""

    name: str
    reading: Reading
    band: tuple[float | None, float | None] = (None, None)


FILES = (
    Measured("case1.mat", Reading("receptance")),
    Measured("case2.mat", Reading("receptance")),
    Measured("mckiddat.mat", Reading(references=(("Recep_1", ""),))),
    Measured("measurement.uff", Reading()),
    Measured("measurement.uff", Reading(), (20.0, None)),
    Measured("point_1.txt", Reading("receptance"), (20.0, 2000.0)),
    Measured(
        "Point1_Channel1_CH1.txt", Reading("accelerance", points=("p1",), references=(("p1", ""),)), (50.0, 3000.0)
    ),
    Measured(
        "Hxysv0000[149].txt", Reading("accelerance", scale=-1.0, references=(("Hxysv00004", ""),)), (65.0, 1000.0)
    ),
    Measured("H00.mat", Reading("receptance")),
    Measured("H2.mat", Reading("receptance", arrays=("H21",)), (None, 7000.0)),
    Measured("FRF_noise.mat", Reading("receptance"), (1.0, 420.0)),
    Measured("lms_FRF.mat", Reading("mobility")),
    Measured("ds_FRF.csv", Reading(), (1.0, 160.0)),
    *(Measured(f"plate_{n}.npz", Reading("accelerance"), (30.0, 700.0)) for n in ("1L", "2L", "3L")),
    *(Measured(f"syn_{n}.npz", Reading("receptance")) for n in ("viscous", "hysteretic", "viscous_noise")),
    *(Measured(f"syn_{n}.npz", Reading("mobility")) for n in ("v_add60", "h_add60", "h_rel1e-2")),
)


def decibels(fitted: NDArray[Any], measured: NDArray[Any]) -> float:
    """R.m.s. of the levels of one re the other."""
    return float(np.sqrt(np.mean((20 * np.log10(np.abs(fitted) / np.abs(measured))) ** 2)))


def by_sdypy(r: Responses, frequencies: list[float]) -> tuple[int, float, NDArray[Any]]:
    """Poles found, misfit in dB, and Q, of sdypy-EMA at these frequencies."""
    from sdypy.EMA import Model

    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        slow = 1000 / r.freq[-1] if r.freq[-1] < LOWEST else 1.0  # its windows are in Hz
        step = slow * float(np.median(np.diff(r.freq)))
        below = round(slow * r.freq[0] / step)  # it counts bins from 0 Hz on
        freq = np.arange(below + r.freq.size) * step
        accelerance = np.pad(r.mobility * 2j * np.pi * r.freq, ((0, 0), (below, 0)), "edge")
        model = Model(accelerance, freq, lower=freq[below], upper=freq[-1], pol_order_high=60, frf_form="accelerance")
        model.get_poles(show_progress=False)
        model.select_closest_poles([slow * f for f in frequencies], f_window=20)
        fitted, _ = model.get_constants(whose_poles="own", FRF_ind="all", upper_r=True, lower_r=True)
    n = fitted.shape[1]
    return len(model.nat_freq), decibels(fitted[:, below:], accelerance[:, below:n]), 0.5 / np.asarray(model.nat_xi)


def row(measured: Measured, folder: Path) -> str | None:
    """Row of the table."""
    paths = sorted(folder.glob(measured.name))
    if not paths:
        return None
    start = time.process_time()
    try:
        fit: Fit = fit_responses(read_responses(paths, measured.reading), band=measured.band)
    except TonewoodError as fault:
        return f"| {measured.name} | | {fault} | | | | | | | |"
    seconds = time.process_time() - start
    r, (problem, poles, solution) = fit.responses, fit.modes.bent
    modes = [x for x in fit.rows if x["measured"]]
    ours = decibels(problem.model(poles, solution.residues), r.mobility)
    verdict = ("structural" if fit.modes.structural else "viscous") + (", body" if fit.body else ", modes only")
    band = f"{r.freq[0]:.4g} to {r.freq[-1]:.4g}"
    start = time.process_time()
    try:
        n, theirs, quality = by_sdypy(replace(r, coherence=None), [x["freq_Hz"] for x in modes])
        peer = f"{n} | {theirs:.2f} | {np.round(quality, 1).tolist()}"
    except Exception as fault:  # whatever it raises is its verdict
        peer = f"{type(fault).__name__} | |"
    theirs_s = time.process_time() - start
    q = [round(x["Q"], 1) for x in modes]
    print(measured.name, "f", [round(x["freq_Hz"], 4) for x in modes], "Q", q, "sdypy", peer, file=sys.stderr)
    cells = [measured.name, band, verdict, str(len(modes)), f"{fit.modes.misfit:.2f}", f"{ours:.2f}", f"{seconds:.1f}"]
    return "| " + " | ".join([*cells, *peer.split(" | ")[:2], f"{theirs_s:.1f}"]) + " |"


def main() -> None:
    """Print the table."""
    print("| file | band, Hz | verdict | modes | misfit / noise | dB | s | sdypy-EMA: modes | dB | s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    wanted = sys.argv[2:]
    for measured in FILES:
        if (not wanted or measured.name in wanted) and (line := row(measured, Path(sys.argv[1]))) is not None:
            print(line, flush=True)


if __name__ == "__main__":
    main()
