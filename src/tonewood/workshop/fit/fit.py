"""One measurement fitted: checks, modes, a passive body, and its uncertainties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.fit import noise
from tonewood.workshop.fit.body import FittedBody, passive_body
from tonewood.workshop.fit.identify import Modes, identify
from tonewood.workshop.fit.projection import Shape
from tonewood.workshop.fit.responses import Responses
from tonewood.workshop.fit.search import Iteration, NothingFoundError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: bins that a bandwidth has to hold for the bins to show its damping
BINS_IN_BANDWIDTH = 3.0
#: misfit, re the noise, above which the model does not do
MOST_MISFIT = 1.5


@dataclass(frozen=True, eq=False)
class Fit:
    """A body fitted to responses.

    Attributes
    ----------
    responses : of the band.
    modes : identified, with real residues.
    body : passive, made from them.
    """

    responses: Responses
    modes: Modes
    body: FittedBody

    def __repr__(self) -> str:
        return f"<Fit of {np.count_nonzero(self.body.measured)} modes, {self.error_db.max():.2f} dB at most>"

    @cached_property
    def mobility(self) -> Complexes:
        """(P, N) (m/s)/N of the body at the measured pairs."""
        r = self.responses
        return self.body.mobility(r.freq, r.pairs, r.alpha)

    @cached_property
    def error_db(self) -> Floats:
        """(P, N) dB, magnitude of the body's mobility re the measured one: noise included."""
        return np.asarray(np.abs(20 * np.log10(np.abs(self.mobility) / np.abs(self.responses.mobility))))

    @cached_property
    def without_db(self) -> list[float]:
        """Return for each mode the largest change, dB, of the mobility at the driving points if it is dropped."""
        r, body = self.responses, self.body
        s, driving = r.alpha + 2j * np.pi * r.freq, list(r.driving)
        out = []
        for f, q, shape in zip(body.freq, body.quality, body.shapes, strict=True):
            w = 2 * np.pi * f
            own = np.array([shape[body.points.index(r.pairs[i][0])] ** 2 for i in driving])[:, None]
            without = self.mobility[driving] - own * s / (s * s + w / q * s + w * w)
            out.append(float(np.abs(20 * np.log10(np.abs(without) / np.abs(self.mobility[driving]))).max()))
        return out

    @property
    def warnings(self) -> list[str]:
        """List doubts about this body, a line each."""
        r, body, out = self.responses, self.body, []
        step = float(r.freq[1] - r.freq[0])
        bandwidth = body.freq / body.quality + r.alpha / np.pi
        for freq, quality, width in zip(body.freq, body.quality, bandwidth, strict=True):
            if r.freq[0] <= freq <= r.freq[-1] and width < BINS_IN_BANDWIDTH * step:
                out.append(
                    f"mode at {freq:.1f} Hz: its bandwidth of {width:.2g} Hz (Q {quality:.0f}) holds fewer than "
                    f"{BINS_IN_BANDWIDTH:g} bins of {step:g} Hz; measure longer"
                )
        for end in (r.freq[0], r.freq[-1]):
            near = body.measured & (np.abs(body.freq - end) < body.freq / body.quality)
            out += [f"the band ends in the peak of the mode at {f:.1f} Hz: move --band" for f in body.freq[near]]
        if self.modes.misfit > MOST_MISFIT:
            out.append(
                f"the misfit is {self.modes.misfit:.2f} times the noise: the body is not linear, the records leak, or "
                "the noise was taken for too small"
            )
        for i in r.driving:
            parts = [f"{low:.0f} to {high:.0f} Hz" for low, high in r.incoherent(i) if high > low]
            if parts:
                more = f" and {len(parts) - 3} more" if len(parts) > 3 else ""
                shown = ", ".join(parts[:3]) + more
                out.append(f"the coherence at {r.pairs[i][0]} is low: {shown}; move --band, or hit anew")
        if r.coherence is not None and r.n_hits is None:
            out.append("the coherences were not used: --hits says how many hits were averaged")
        if len(r.references) == 1 and len(r.points) > 1:
            out.append(
                f"driven at {r.references[0]} alone: mobilities among other points follow from one shape a mode and "
                "may be 1 to 4 dB off; a second reference would tell"
            )
        return out

    def facts(self) -> dict[str, Any]:
        """Return everything but the curves, for JSON."""
        r, body, line = self.responses, self.body, self.modes.problem.line
        return {
            "files": dict(r.files),
            "band_Hz": [float(r.freq[0]), float(r.freq[-1])],
            "step_Hz": float(r.freq[1] - r.freq[0]),
            "window_tau_s": 1 / r.alpha if r.alpha else None,
            "hits": None if r.kept is None else {"kept": r.kept[0], "given": r.kept[1]},
            "pairs": [list(pair) for pair in r.pairs],
            "noise": [float(np.sqrt(np.mean(row**2))) for row in line.sigma],
            "price": self.modes.bent[0].price,
            "misfit": self.modes.misfit,
            "residues_turned": self.modes.turned,
            "error_db": {
                "rms": float(np.sqrt(np.mean(self.error_db**2))),
                "95%": float(np.quantile(self.error_db, 0.95)),
                "most": float(self.error_db.max()),
            },
            "modes": [
                {
                    "freq_Hz": float(f), "Q": float(q), "mass_kg": _mass(shape), "shape": shape.tolist(),
                    "sd_cents": _or_none(c), "sd_Q": _or_none(e), "sd_shape": _or_none(p), "measured": bool(m),
                    "without_db": without,
                }
                for f, q, shape, c, e, p, m, without in zip(
                    body.freq, body.quality, body.shapes, body.cents, body.quality_error, body.shape_error,
                    body.measured, self.without_db, strict=True,
                )
            ],
            "compliance_m_per_N": body.compliance.tolist(),
            "dropped": list(body.dropped),
            "warnings": self.warnings,
        }  # fmt: skip

    def table(self) -> str:
        """Return the body as a CSV table of `modal_table` (`shapes: points`); numbers read back are the same."""
        r, body = self.responses, self.body
        head = [
            f"# Fitted to {', '.join(r.files) or 'responses'} from {r.freq[0]:g} to {r.freq[-1]:g} Hz; mass-normalised "
            "shapes, 1/sqrt(kg).",
            "# measured 0: beyond the band, a stand-in for what lies there. sd: one standard deviation.",
            ",".join(["f_Hz", "Q", *body.points, "sd_cents", "sd_Q_percent", "measured"]),
        ]
        rows = []
        for i, (f, q, shape) in enumerate(zip(body.freq, body.quality, body.shapes, strict=True)):
            sure = bool(body.measured[i])
            cents, error = (body.cents[i], 100 * body.quality_error[i]) if sure else (0.0, 0.0)
            numbers = [repr(float(x)) for x in (f, q, *shape)]
            rows.append(",".join([*numbers, f"{cents:.3g}", f"{error:.3g}", str(int(sure))]))
        return "\n".join([*head, *rows]) + "\n"


def _mass(shape: Floats) -> float | None:
    """kg, modal mass as felt at the first point."""
    return float(1 / shape[0] ** 2) if shape[0] else None


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


@one_blas_thread
def fit_responses(
    responses: Responses,
    *,
    band: tuple[float | None, float | None] = (None, None),
    tell: Callable[[Iteration], None] = lambda iteration: None,
) -> Fit:
    """Fit a passive body of real modes to measured responses.

    Parameters
    ----------
    responses : of points and references; each reference was measured where it was driven.
    band : Hz, lower and upper end; the ends of the data where None.
    tell : called after each iteration of the search.

    Returns
    -------
    The body, its modes with their uncertainties, and the checks.

    Raises
    ------
    TonewoodError : the responses are no passive body's, or no mode stands out of their noise.
    """
    r = responses.band(*band).checked()
    sigma = None
    if r.coherence is not None and r.n_hits is not None:
        sigma = noise.of_coherence(r.mobility, r.coherence, r.n_hits)
    try:
        modes = identify(r.freq, r.mobility, Shape(r.driving, len(r.points)), sigma=sigma, alpha=r.alpha, tell=tell)
    except NothingFoundError:
        raise TonewoodError("no mode stands out of the noise: wrong files, band or units", key="responses") from None
    body = passive_body(modes, r.pairs)
    if body.compliance.any() and sla.eigvalsh(body.compliance).min() < 0:  # to rounding: rank one is on the edge
        values, vectors = sla.eigh(body.compliance)
        body.compliance[:] = (vectors * np.maximum(values, 0)) @ vectors.T
    return Fit(r, modes, body)
