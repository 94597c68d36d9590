"""One measurement fitted: checks, modes, a passive body, and its uncertainties."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sla

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.fit import noise
from tonewood.workshop.fit.body import LEAST_QUALITY, FittedBody, passive_body
from tonewood.workshop.fit.identify import Modes, identify
from tonewood.workshop.fit.projection import Shape
from tonewood.workshop.fit.responses import Responses
from tonewood.workshop.fit.search import Iteration, NothingFoundError

#: bins that a bandwidth has to hold for the bins to show its damping
BINS_IN_BANDWIDTH = 3.0
#: misfit, re the noise, above which the model does not do
MOST_MISFIT = 1.5
#: Hz, upper end of a band below which frequencies were hardly meant in Hz
LEAST_TOP = 20.0
#: kg, medians of modal masses that a plate, a bar or a guitar has
LEAST_MASS, MOST_MASS = 1e-3, 1e3
#: most modes that a warning of the same kind names a line each
MOST_LINES = 2
#: standard deviations of half of a central interval of 90 % of a normal distribution
NORMAL_90 = 1.6449


@dataclass(frozen=True, eq=False)
class Fit:
    """A body fitted to responses.

    Attributes
    ----------
    responses : of the band.
    modes : identified, with real residues.
    body : passive, made from them; None where the responses are no body's.
    no_body : why, in one line.
    not_driven : references that were left out, for nothing was measured where they were driven.
    outliers : Hz, bins that were left out, for they disagree with their neighbours.
    empty : number of bins that were left out, for a response holds no finite number, or 0, there.
    """

    responses: Responses
    modes: Modes
    body: FittedBody | None
    no_body: str | None = None
    not_driven: tuple[str, ...] = ()
    outliers: tuple[float, ...] = ()
    empty: int = 0

    def __repr__(self) -> str:
        return f"<Fit of {len(self.rows)} modes, {self.error_db.max():.2f} dB at most>"

    @cached_property
    def mobility(self) -> Complexes:
        """(P, N) (m/s)/N of the body at the measured pairs; of the modes where there is no body."""
        r = self.responses
        if self.body is not None:
            return self.body.mobility(r.freq, r.pairs, r.alpha)
        problem, poles, solution = self.modes.bent
        return problem.model(poles, solution.residues)

    @cached_property
    def error_db(self) -> Floats:
        """(P, N) dB, magnitude of that mobility re the measured one: noise included."""
        return np.asarray(np.abs(20 * np.log10(np.abs(self.mobility) / np.abs(self.responses.mobility))))

    @cached_property
    def without_db(self) -> list[float]:
        """Return for each row the largest change, dB, of the mobility at the driving points if it is dropped."""
        r, body = self.responses, self.body
        s, out = r.alpha + 2j * np.pi * r.freq, []
        if body is None:
            problem, poles, solution = self.modes.bent
            columns, k = problem.columns(poles)[0], len(poles)
            at_drive = [solution.residues[:, [i, i + k]] @ columns[[i, i + k]] for i in range(k)]
            return [_change(self.mobility, part) for part in at_drive]
        driving = list(r.driving)
        for f, q, shape in zip(body.freq, body.quality, body.shapes, strict=True):
            w = 2 * np.pi * f
            size = np.array([shape[body.points.index(r.pairs[i][0])] ** 2 for i in driving])[:, None]
            out.append(_change(self.mobility[driving], size * s / (s * s + w / q * s + w * w)))
        return out

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """Modes as numbers, with intervals that hold the truth nine times of ten where the model is right."""
        r, body, bent = self.responses, self.body, self.modes.bent[1]
        if body is None:
            return self._rows_of_modes()
        out = []
        for i, (f, q, shape) in enumerate(zip(body.freq, body.quality, body.shapes, strict=True)):
            near = int(np.argmin(np.abs(np.log(bent.freq / f))))
            measured = bool(body.measured[i])
            mass, cents, error = _mass(shape), body.cents[i], body.quality_error[i]
            out.append({
                "freq_Hz": float(f), "Q": float(q), "mass_kg": mass, "shape": shape.tolist(),
                "sd_cents": _or_none(cents), "sd_Q": _or_none(error), "sd_shape": _or_none(body.shape_error[i]),
                "interval_90": _intervals(f, q, mass, cents, error, body.shape_error[i]) if measured else None,
                "mpc": float(self.modes.complexity[near]) if measured and len(r.pairs) > 1 else None,
                "measured": measured, "without_db": self.without_db[i],
            })  # fmt: skip
        return out

    def _rows_of_modes(self) -> list[dict[str, Any]]:
        """Modes without a body: shapes are complex residues re the largest."""
        r, (problem, poles, solution) = self.responses, self.modes.bent
        by_freq, by_zeta, _ = problem.deviations(poles)
        k, out = len(poles), []
        cents = 1200 / np.log(2) * by_freq
        for i, (f, q) in enumerate(zip(poles.freq, poles.quality, strict=True)):
            shape = solution.residues[:, i] - 1j * solution.residues[:, i + k]
            shape = shape / shape[np.argmax(np.abs(shape))]
            in_band = bool(r.freq[0] <= f <= r.freq[-1] and q >= LEAST_QUALITY)
            out.append({
                "freq_Hz": float(f), "Q": float(q), "mass_kg": None, "shape": [[x.real, x.imag] for x in shape],
                "sd_cents": _or_none(cents[i]), "sd_Q": _or_none(by_zeta[i]), "sd_shape": None,
                "interval_90": _intervals(f, q, None, cents[i], by_zeta[i], 0.0) if in_band else None,
                "mpc": float(self.modes.complexity[i]) if len(r.pairs) > 1 else None,
                "measured": in_band, "without_db": self.without_db[i],
            })  # fmt: skip
        return out

    @property
    def warnings(self) -> list[str]:
        """List doubts about this body, a line each."""
        r, out = self.responses, [] if self.no_body is None else [f"no passive body: {self.no_body}"]
        step, measured = float(np.median(np.diff(r.freq))), [row for row in self.rows if row["measured"]]
        narrow = [x for x in measured if x["freq_Hz"] / x["Q"] + r.alpha / np.pi < BINS_IN_BANDWIDTH * step]
        if len(narrow) > MOST_LINES:
            shown = ", ".join(f"{x['freq_Hz']:.5g}" for x in narrow)
            out.append(
                f"{len(narrow)} modes are narrower than {BINS_IN_BANDWIDTH:g} bins of {step:g} Hz ({shown} Hz): their "
                "Q is uncertain; measure longer"
            )
        else:
            for freq, quality in ((x["freq_Hz"], x["Q"]) for x in narrow):
                width = freq / quality + r.alpha / np.pi
                out.append(
                    f"mode at {freq:.1f} Hz: its bandwidth of {width:.2g} Hz (Q {quality:.0f}) holds fewer than "
                    f"{BINS_IN_BANDWIDTH:g} bins of {step:g} Hz; measure longer"
                )
        out += r.remarks
        for end in (r.freq[0], r.freq[-1]):
            near = [row["freq_Hz"] for row in measured if abs(row["freq_Hz"] - end) < row["freq_Hz"] / row["Q"]]
            out += [f"the band ends in the peak of the mode at {f:.1f} Hz: move --band" for f in near]
        if self.not_driven:
            shown = ", ".join(map(repr, self.not_driven[:4]))
            out.append(f"responses from {shown} were left out: nothing was measured where these were driven")
        if self.outliers:
            shown = ", ".join(f"{f:.5g}" for f in self.outliers[:6]) + (" ..." if len(self.outliers) > 6 else "")
            out.append(f"bins that disagree with their neighbours were left out, {len(self.outliers)}: {shown} Hz")
        if self.modes.mains:
            shown = ", ".join(f"{f:.1f}" for f in sorted(self.modes.mains)[:6])
            out.append(f"lines of a few bins, of the mains perhaps, were left out: {shown} Hz")
        if self.modes.idle:
            shown = ", ".join(f"{f:.5g}" for f in sorted(self.modes.idle)[:6]) + (
                " ..." if len(self.modes.idle) > 6 else ""
            )
            out.append(
                f"{len(self.modes.idle)} weak or doubtful modes were left out, the fit is less than 0.05 dB worse "
                f"without each ({shown} Hz); --keep {sorted(self.modes.idle)[0]:.5g} would keep one"
            )
        if self.modes.misfit > MOST_MISFIT:
            out.append(
                f"the misfit is {self.modes.misfit:.2f} times the noise: the body is not linear, the records leak, or "
                "the noise was taken for too small"
            )
        if r.freq[-1] < LEAST_TOP:
            out.append(f"the responses end at {r.freq[-1]:.3g} Hz: kHz read as Hz, perhaps; freq_Hz is in Hz")
        if self.empty:
            out.append(f"{self.empty} bins without a finite number, or with 0, were left out")
        masses = [row["mass_kg"] for row in measured if row["mass_kg"]]
        if masses and not LEAST_MASS < float(np.median(masses)) < MOST_MASS:
            side = "less" if np.median(masses) < 1 else "more"
            out.append(
                f"half of the modes weigh {side} than {np.median(masses):.2g} kg: likely causes: mm/s read as m/s "
                "(--scale 1e-3), g read as m/s2 or the reverse (--scale 9.80665), mV in place of N (--sensitivity), "
                "or --form is wrong"
            )
        for i in r.driving or (0,):
            parts = [f"{low:.0f} to {high:.0f} Hz" for low, high in r.incoherent(i) if high > low]
            if parts:
                more = f" and {len(parts) - 3} more" if len(parts) > 3 else ""
                shown = ", ".join(parts[:3]) + more
                out.append(f"the coherence at {r.pairs[i][0]} is low: {shown}; move --band, or hit anew")
        if r.coherence is not None and r.n_hits is None:
            out.append("the coherences were not used: --hits says how many hits were averaged")
        if self.body is not None and len(r.references) == 1 and len(r.points) > 1:
            out.append(
                f"driven at {r.references[0]} alone: mobilities among other points follow from one shape a mode and "
                "may be 1 to 4 dB off; a second reference would tell"
            )
        return out

    def facts(self) -> dict[str, Any]:
        """Return everything but the curves, for JSON."""
        r, data = self.responses, self.modes.problem.data
        return {
            "files": dict(r.files),
            "band_Hz": [float(r.freq[0]), float(r.freq[-1])],
            "step_Hz": float(np.median(np.diff(r.freq))),
            "window_tau_s": 1 / r.alpha if r.alpha else None,
            "hits": None if r.kept is None else {"kept": r.kept[0], "given": r.kept[1]},
            "pairs": [list(pair) for pair in r.pairs],
            "noise": [float(np.sqrt(np.mean(row**2))) for row in data.sigma],
            "price": self.modes.bent[0].price,
            "damping": "structural" if self.modes.structural else "viscous",
            "misfit": self.modes.misfit,
            "muted_Hz": list(self.modes.mains),
            "idle_Hz": list(self.modes.idle),
            "outliers_Hz": list(self.outliers),
            "no_body": self.no_body,
            "residues_turned": self.modes.turned,
            "error_db": {
                "rms": float(np.sqrt(np.mean(self.error_db**2))),
                "95%": float(np.quantile(self.error_db, 0.95)),
                "most": float(self.error_db.max()),
            },
            "modes": self.rows,
            "compliance_m_per_N": None if self.body is None else self.body.compliance.tolist(),
            "dropped": [] if self.body is None else list(self.body.dropped),
            "warnings": self.warnings,
        }  # fmt: skip

    def table(self) -> str:
        """Return the body as a CSV table of `modal_table` (`shapes: points`); numbers read back are the same.

        Without a body, the modes: shapes as real and imaginary parts of each response, re the largest.
        """
        r, body = self.responses, self.body
        if body is None:
            names = [f"{point}:{reference}_{part}" for point, reference in r.pairs for part in ("re", "im")]
            shapes = [[x for pair in row["shape"] for x in pair] for row in self.rows]
        else:
            names, shapes = list(body.points), [row["shape"] for row in self.rows]
        scale = "complex residues re the largest" if body is None else "mass-normalised shapes, 1/sqrt(kg)"
        head = [
            f"# Fitted to {', '.join(r.files) or 'responses'} from {r.freq[0]:g} to {r.freq[-1]:g} Hz; {scale}.",
            "# measured 0: beyond the band, a stand-in for what lies there. sd: one standard deviation.",
            ",".join(["f_Hz", "Q", *names, "sd_cents", "sd_Q_percent", "measured"]),
        ]
        rows = []
        for row, shape in zip(self.rows, shapes, strict=True):
            cents, error = (row["sd_cents"], 100 * row["sd_Q"]) if row["measured"] else (0.0, 0.0)
            numbers = [repr(float(x)) for x in (row["freq_Hz"], row["Q"], *shape)]
            rows.append(",".join([*numbers, f"{cents:.3g}", f"{error:.3g}", str(int(row["measured"]))]))
        return "\n".join([*head, *rows]) + "\n"


def _change(whole: Complexes, part: Complexes) -> float:
    """Largest change of level, dB, if a part is taken out."""
    return float(np.abs(20 * np.log10(np.abs(1 - part / whole) + 1e-300)).max())


def _intervals(
    freq: float, quality: float, mass: float | None, cents: float, error: float, shape_error: float
) -> dict[str, list[float] | None]:
    """Central intervals of 90 %, of normal errors of the logarithms."""
    out: dict[str, list[float] | None] = {}
    errors = (("freq_Hz", freq, cents * np.log(2) / 1200), ("Q", quality, error), ("mass_kg", mass, 2 * shape_error))
    for name, value, deviation in errors:
        if value is None or not np.isfinite(deviation):
            out[name] = None
            continue
        out[name] = [float(value * np.exp(sign * NORMAL_90 * deviation)) for sign in (-1, 1)]
    return out


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
    damping: str = "auto",
    keep: Sequence[float] = (),
    drop: Sequence[float] = (),
    tell: Callable[[Iteration], None] = lambda iteration: None,
) -> Fit:
    """Fit a passive body of real modes to measured responses.

    Parameters
    ----------
    responses : of points and references; a passive body is made where one of these was measured where it was driven.
    band : Hz, lower and upper end; the ends of the data where None.
    damping : viscous, structural or auto.
    keep, drop : Hz, where a mode has to be, and where none is wanted.
    tell : called after each iteration of the search.

    Returns
    -------
    The modes with their uncertainties, the body if the responses are a passive one's, and the checks.

    Raises
    ------
    TonewoodError : the responses hold no numbers to be fitted, no mode stands out of their noise, or `keep` lies
        outside the band or in `drop`.
    """
    r, not_driven = responses.reciprocal().of_driven()
    some = (r.freq > 0) & (r.freq >= (band[0] or 0.0)) & (r.freq <= (band[1] or np.inf))
    empty = int(np.count_nonzero(some & ~r.measured))
    r, outliers = r.band(*band).checked().without_outliers()
    for f in keep:
        if not r.freq[0] <= f <= r.freq[-1]:
            raise TonewoodError(
                f"{f:g} Hz lies outside {r.freq[0]:g} to {r.freq[-1]:g} Hz, the band that is fitted", key="--keep"
            )
        if f in drop:
            raise TonewoodError(f"{f:g} Hz is to be dropped, too; one of the two is allowed", key="--keep")
    no_body = r.no_body()
    sigma = None
    if r.coherence is not None and r.n_hits is not None:
        sigma = noise.of_coherence(r.mobility, r.coherence, r.n_hits)
    shape = Shape(r.driving, len(r.points)) if no_body is None else Shape((), len(r.pairs))
    try:
        modes = identify(
            r.freq, r.mobility, shape, sigma=sigma, alpha=r.alpha, damping=damping, keep=keep,
            drop=drop, tell=tell,
        )  # fmt: skip
    except LookupError as fault:
        raise TonewoodError(str(fault), key="--drop") from None
    except NothingFoundError:
        raise TonewoodError(
            "no mode stands out of the noise: wrong files, band or units, or imaginary parts of the other sign "
            "(a file for exp(-jwt): take the conjugate)", key="responses",
        ) from None  # fmt: skip
    body = None
    if no_body is None:
        body = passive_body(modes, r.pairs)
        if not np.any(body.measured):
            body, no_body = None, "no mode of the band has a positive residue where the body was driven"
    if body is not None and body.compliance.any() and sla.eigvalsh(body.compliance).min() < 0:
        values, vectors = sla.eigh(body.compliance)  # to rounding: rank one is on the edge
        body.compliance[:] = (vectors * np.maximum(values, 0)) @ vectors.T
    return Fit(r, modes, body, no_body, not_driven, outliers, empty)
