"""``tonewood fit``: measured responses of a body to a table of its modes."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.commands import InterruptError
from tonewood.cli.common import Json, allow, allow_band, allow_word, print_json, warn
from tonewood.errors import TonewoodError
from tonewood.support.units import number_in

if TYPE_CHECKING:
    from tonewood.workshop.fit.folder import FitFolder, MeasuredPoint
    from tonewood.workshop.fit.responses import Responses
    from tonewood.workshop.fit.search import Iteration

#: names of points and microphones: words of paths and columns; these are other columns of the table
_NAME, _COLUMNS = re.compile(r"[A-Za-z][A-Za-z0-9_]*"), ("f_Hz", "Q", "zeta", "modal_mass", "measured")
#: a point of a universal file, and its directions
_NODE, _AXES = re.compile(r"(\d+)([+-][0-6])"), {"1": "x", "2": "y", "3": "z"}
_VECTORS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def fit(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES",
            help="responses (.csv, .txt, .npz, .mat, .uff), or hammer hits, one a file (.wav, .csv, .txt)",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FOLDER", help="folder to write")],
    form: Annotated[
        str | None, typer.Option(help="quantity measured: accelerance, mobility or receptance, per N")
    ] = None,
    scale: Annotated[
        float, typer.Option(help="SI units per unit of the responses: 9.80665 for g/N; -1 turns the sign")
    ] = 1.0,
    band: Annotated[
        tuple[float, float] | None, typer.Option(metavar="LOW HIGH", help="Hz, part of the data that is fitted")
    ] = None,
    driving: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=BEGIN]",
            help="point that was driven: in all files, in hits whose names begin so, or called so as a reference",
        ),
    ] = None,
    array: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help=".npz, .mat: array that holds responses; repeatable")
    ] = None,
    damping: Annotated[
        str, typer.Option(help="viscous, structural (hysteretic), or auto: the one that fits with fewer modes")
    ] = "auto",
    keep: Annotated[
        str | None, typer.Option(metavar="HZ,...", help="frequencies where a mode has to be, whatever it gains")
    ] = None,
    drop: Annotated[str | None, typer.Option(metavar="HZ,...", help="frequencies of modes that are not wanted")] = None,
    points: Annotated[
        str | None, typer.Option(metavar="NAMES", help="hits: points of channels 2 on, by commas; NAME_Pa: microphone")
    ] = None,
    sensitivity: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="hits: N, then m/s^2 (m/s, m, Pa) at full scale of WAV, per unit of texts, by commas",
        ),
    ] = None,
    point: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NODE=NAME[:DIRECTION[:U]]",
            help="another name for a point, its direction (x, y, z) and place along the bridge, -1 to 1; repeatable",
        ),
    ] = None,
    window_tau: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="exponential window: taken for hits, in the data otherwise")
    ] = None,
    hits: Annotated[int | None, typer.Option(help="hits that were averaged, where the files hold coherences")] = None,
    estimator: Annotated[str, typer.Option(help="of hits: H1 (noise in the motion) or H2 (in the force)")] = "H1",
    title: Annotated[str | None, typer.Option(help="the object measured, for the sources")] = None,
    measured_by: Annotated[str | None, typer.Option(help="who measured it, for the sources; unknown otherwise")] = None,
    licence: Annotated[str | None, typer.Option(help="SPDX name of the data's licence; unknown otherwise")] = None,
    as_json: Json = False,
) -> None:
    """Fit modes to measured responses, and a passive body to those of which one was measured where it was driven.

    Writes body.csv, body.yaml, fit.json, fit.png and, with microphones, radiation.csv; `tonewood new` reads the folder.
    Where no passive body has such responses: modes.csv, fit.json and fit.png, and a warning that says why.
    """
    from tonewood.workshop.fit.files import Reading, read_responses
    from tonewood.workshop.fit.fit import fit_responses
    from tonewood.workshop.fit.folder import UNKNOWN, FitFolder, Origin
    from tonewood.workshop.fit.radiation import fit_radiation

    _check_options(form, estimator, scale, window_tau, hits, band)
    allow_word("--damping", damping, ("viscous", "structural", "auto"))
    kept, dropped = _frequencies("--keep", keep), _frequencies("--drop", drop)
    _check_folder(output)
    reading = Reading(
        form=form, n_hits=hits, window_tau=window_tau, points=tuple(_words(points)), references=_references(driving),
        sensitivity=_numbers(sensitivity), estimator=estimator, scale=scale, arrays=tuple(array or ()),
    )  # fmt: skip
    responses, places = _named(read_responses(files, reading), point or [])
    draw = _figure()
    tell = _Teller()
    try:
        fitted = fit_responses(
            responses, band=band or (None, None), damping=damping, keep=kept, drop=dropped, tell=tell
        )
        places_u = {name: location.u for name, location in places.items() if location.u is not None}
        radiation = None if fitted.body is None else fit_radiation(fitted.responses, fitted.body, places_u, tell=tell)
        origin = Origin(title or UNKNOWN, measured_by or UNKNOWN, licence or UNKNOWN)
        settings = {
            "form": form, "scale": scale, "band": band, "window_tau": window_tau, "hits": hits, "estimator": estimator,
            "driving": driving, "points": points, "sensitivity": sensitivity, "point": point,
            "array": array, "damping": damping, "keep": keep, "drop": drop,
        }  # fmt: skip
        folder = FitFolder(fitted, radiation, places, origin, settings)
        written = folder.write(output, draw)
    except KeyboardInterrupt:
        raise InterruptError from None
    finally:
        tell.end()
    warnings = list(fitted.warnings)
    if draw is None:
        warnings.append("fit.png was not drawn: matplotlib is not installed (pip install 'tonewood[plot]')")
    if as_json:
        report = {**folder.facts(), "warnings": warnings, "written": [str(path) for path in written]}
        print_json("fit", report)
        return
    warn(warnings)
    _print(folder, written)


def _check_options(
    form: str | None,
    estimator: str,
    scale: float,
    window_tau: float | None,
    hits: int | None,
    band: tuple[float, float] | None,
) -> None:
    from tonewood.workshop.fit.responses import FORMS

    if form is not None:
        allow_word("--form", form, FORMS)
    allow_word("--estimator", estimator, ("H1", "H2"))
    allow("--scale", abs(scale), 1e-9, 1e9, "")
    if window_tau is not None:
        allow("--window-tau", window_tau, 1e-4, 1e3, "s")
    if hits is not None:
        allow("--hits", hits, 2, 100_000, "hits")
    if band is not None:
        allow_band(band)


def _check_folder(output: Path) -> None:
    """Refuse before any work a target that cannot be written."""
    if output.exists() and not output.is_dir():
        raise TonewoodError("is a file; a folder is allowed", key="--output", file=output)
    if not output.absolute().parent.is_dir():
        raise TonewoodError(f"there is no folder {str(output.parent)!r}", key="--output")
    if (output / "instrument.yaml").exists():
        raise TonewoodError("holds an instrument; a folder of its own is allowed", file=output, key="--output")


def _words(text: str | None) -> list[str]:
    return [] if text is None else [word.strip() for word in text.split(",")]


def _numbers(text: str | None) -> tuple[float, ...]:
    out = []
    for word in _words(text):
        out.append(number_in(word))
        if math.isnan(out[-1]):
            raise TonewoodError(f"{word!r} is no number; numbers by commas are allowed", key="--sensitivity")
        if out[-1] == 0 or not abs(out[-1]) < float("inf"):
            raise TonewoodError(
                f"{word} is not allowed: a value at full scale other than 0 is needed", key="--sensitivity"
            )
    return tuple(out)


def _frequencies(key: str, text: str | None) -> tuple[float, ...]:
    values = tuple(number_in(word) for word in _words(text))
    for word, value in zip(_words(text), values, strict=True):
        if not 0 < value < math.inf:
            raise TonewoodError(f"{word!r} is no frequency; numbers above 0 by commas are allowed", key=key)
    return values


def _references(texts: list[str] | None) -> tuple[tuple[str, str], ...]:
    pairs = [(name, begin) for name, _, begin in (text.partition("=") for text in texts or [])]
    return tuple(sorted(pairs, key=lambda pair: -len(pair[1])))


def _named(responses: Responses, texts: list[str]) -> tuple[Responses, dict[str, MeasuredPoint]]:
    """Responses with the names that are wanted, and where the points are."""
    from tonewood.workshop.fit.folder import MeasuredPoint

    names, places = {}, {}
    for old in (*responses.points, *responses.microphones):
        node = _NODE.fullmatch(old)
        if node is not None:
            axis = _AXES.get(node[2][1], "")
            names[old] = f"n{node[1]}{'' if axis in ('', 'z') else f'_{axis}'}{'_back' if node[2][0] == '-' else ''}"
            sign = -1.0 if node[2][0] == "-" else 1.0
            if axis:
                x, y, z = _VECTORS[axis]
                places[names[old]] = MeasuredPoint(axis if sign > 0 else (sign * x, sign * y, sign * z))
    for text in texts:
        old, equals, rest = text.partition("=")
        name, *more = rest.split(":")
        if not equals or len(more) > 2:
            raise TonewoodError(f"is {text!r}; NODE=NAME, NODE=NAME:DIRECTION or NODE=NAME:DIRECTION:U", key="--point")
        point = places.pop(names.get(old, old), MeasuredPoint())
        if more and more[0]:
            if more[0] not in _VECTORS:
                raise TonewoodError(f"is {text!r}; the directions x, y, z are allowed", key="--point")
            point = replace(point, direction=more[0])
        if len(more) == 2:
            point = replace(point, u=_place_on_bridge(text, more[1]))
        names[old] = name
        places[name] = point
    renamed = responses.renamed(names)
    for name in (*renamed.points, *renamed.microphones):
        if not _NAME.fullmatch(name) or name in _COLUMNS or name.startswith("sd_"):
            raise TonewoodError(
                f"{name!r} cannot be the name of a point: letters, digits and _ are allowed, and not "
                f"{', '.join(_COLUMNS)} or sd_...; rename it by --point '{name}=NAME'",
                key="--point",
            )
    return renamed, places


def _place_on_bridge(text: str, word: str) -> float:
    u = number_in(word)
    if not -1.0 <= u <= 1.0:
        raise TonewoodError(f"is {text!r}; the place U is a number from -1 (bass) to 1 (treble)", key="--point")
    return u


def _figure() -> Any:
    """Function that draws the figure; None without matplotlib."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        return None
    from tonewood.workshop.fit.figure import draw_fit

    return draw_fit


class _Teller:
    """Tells on a terminal how far the search is; silent in a pipe."""

    def __init__(self) -> None:
        self._on = sys.stderr.isatty()

    def __call__(self, iteration: Iteration) -> None:
        if self._on:
            line = f"\r{len(iteration.freq)} modes, misfit {iteration.misfit:.3g} re noise  "
            print(line, end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._on:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _print(folder: FitFolder, written: list[Path]) -> None:
    fit = folder.fit
    facts, r = folder.facts(), fit.responses
    kept = "" if r.kept is None else f", {r.kept[0]} of {r.kept[1]} hits kept"
    pairs = ", ".join(f"{point}:{reference}" for point, reference in r.pairs)
    print(f"{pairs}: {r.freq[0]:g} to {r.freq[-1]:g} Hz in steps of {facts['step_Hz']:g} Hz{kept}")
    orders = ", ".join(f"{len(iteration.freq)} ({iteration.misfit:.3g})" for iteration in fit.modes.iterations)
    print(f"modes found iteration by iteration, and misfit re noise: {orders}")
    loss = "structural (hysteretic), Q = 1/eta" if fit.modes.structural else "viscous"
    print(f"damping taken for {loss}")
    mass_head = "" if fit.body is None else f"mass at {fit.body.points[0]}/kg"
    print(f"     f/Hz       Q   {mass_head}  +-cents   +-Q    without it   MPC")
    for row in facts["modes"]:
        mass = "" if row["mass_kg"] is None else f"{row['mass_kg']:.3g}"
        if row["measured"]:
            sure = f"{row['sd_cents']:>8.2g} {100 * row['sd_Q']:>5.2g} % {row['without_db']:>8.1f} dB"
            sure += "" if row["mpc"] is None else f"  {row['mpc']:>5.3f}"
        else:
            sure = "  no mode of the band: stands for modes beyond it"
        print(f"{row['freq_Hz']:>9.6g} {row['Q']:>7.1f} {mass:>{len(mass_head)}}  {sure}")
    for line in facts["dropped"]:
        print(f"  dropped: {line}")
    error, what = facts["error_db"], "modes'" if fit.body is None else "body's"
    print(
        f"misfit {facts['misfit']:.2f} times the noise; the {what} mobility re the measured one: "
        f"{error['rms']:.2f} dB r.m.s., {error['95%']:.2f} in 95 % of the bins, {error['most']:.2f} at most"
    )
    if facts["radiation"] is not None:
        heard = facts["radiation"]
        channels = ", ".join(heard["channels"])
        print(f"microphones {channels}: {heard['modes']} modes, {heard['error_db_rms']:.2f} dB r.m.s. off")
    if fit.body is not None:
        print("passive by construction (real modes)")
    print(f"measured by {folder.origin.measured_by}: say who by --measured-by" if folder.origin.measured_by == "unknown"
          else f"measured by {folder.origin.measured_by}")  # fmt: skip
    print(f"written: {', '.join(str(path) for path in written)}")
