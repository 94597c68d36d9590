"""``tonewood modes``: partials of strings on their body, wolf notes, and the mobility of the bridge."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import (
    AllowCode,
    BundleName,
    Json,
    Overrides,
    StringSetName,
    allow_file,
    load,
    need,
    print_json,
)
from tonewood.cli.options import render_options
from tonewood.errors import OutputError, TonewoodError
from tonewood.physics.modal.views import SHOWN_TO
from tonewood.support.plotting import PICTURES
from tonewood.support.units import decibel
from tonewood.support.validation_messages import did_you_mean

if TYPE_CHECKING:
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.instrument.model.assembly import Model

#: modes of a drawn body that are listed and drawn
_LISTED = 12


def modes(
    instrument: BundleName,
    string: Annotated[str | None, typer.Option(help="name of one string; all of them otherwise")] = None,
    stop: Annotated[int, typer.Option(help="stop at which partials are listed, 0 is open")] = 0,
    count: Annotated[int, typer.Option(help="partials listed of each string")] = 12,
    fs: Annotated[int, typer.Option(help="sampling rate to assemble it at, Hz")] = 48000,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="write the bridge mobility to this picture (.png, .pdf, .svg); of a drawn body its modes, too, with "
            "their nodal lines"
        ),
    ] = None,
    table: Annotated[
        Path | None, typer.Option(help="write the body's modes to this table (.csv), which modal_table reads")
    ] = None,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """List the coupled modes of INSTRUMENT's strings: frequency, cents from the harmonic, T60, wolf notes."""
    from tonewood.cli.check import pitch_row, plane_row, plane_words, wolf_line
    from tonewood.instrument.inspection.frequencies import mobility_peaks, partials, pitch, pitches
    from tonewood.instrument.inspection.modal_export import modal_table_text
    from tonewood.instrument.inspection.potentials_at_rest import touched_at_rest, touched_lines
    from tonewood.instrument.model.assembly import assemble
    from tonewood.support.whole_files import write_whole

    render_options({"fs": fs})
    bundle = load(instrument, settings, allow_code, strings)
    model = assemble(bundle, fs, alone=True)
    if string is not None and string not in model.strings:
        hint = f"{did_you_mean(string, model.strings)}there are {', '.join(model.strings) or 'none: a body alone'}"
        raise TonewoodError(f"there is no string {string!r}; {hint}", key="--string")
    if count < 1:
        raise TonewoodError(f"is {count}; 1 or more is allowed", key="--count")
    allow_file("--plot", plot, *PICTURES)
    if plot is not None:
        need("plot", "matplotlib")
    names = [string] if string else list(model.groups)
    for name in names:
        if not 0 <= stop <= model.strings[name].n_stops:
            raise TonewoodError(f"is {stop}; string {name} has 0 to {model.strings[name].n_stops}", key="--stop")
    listed = {name: partials(model, name, stop, count=count) for name in names}
    planes = {name: plane_row(pitch(model, name, stop)) for name in names}
    wolves = [pitch_row(p) for p in pitches(model, names) if p.wolf is not None]
    touched = {part: mine for part, on in touched_at_rest(model).items() if (mine := [n for n in on if n in names])}
    facts = bundle.body.facts()
    peaks = {name: mobility_peaks(model, name) for name in names}
    if plot is not None:
        _plot(model, names, plot)
    if table is not None:
        write_whole(table, modal_table_text(bundle.body, table.name, SHOWN_TO))
    if as_json:
        report: dict[str, Any] = {
            "instrument": bundle.name,
            "stop": stop,
            "strings": {
                name: {
                    "wanted_freq": model.strings[name].freq(stop),
                    "tension": model.strings[name].tension(stop),
                    "planes": planes[name]["planes"],
                    "partials": [
                        {"number": p.number, "freq": p.freq, "cents": p.cents, "t60": p.t60,
                         "string_share": sum(p.shares[:-1]), "body_share": p.shares[-1]}
                        for p in rows
                    ],
                    "bridge_mobility_peaks": [{"freq": f, "mobility": y} for f, y in peaks[name]],
                }
                for name, rows in listed.items()
            },
            "body": {"facts": list(facts), "modes": _body_modes(bundle)},
            "touched_at_rest": touched,
            "wolf_notes": wolves,
            "plot": None if plot is None else str(plot),
            "table": None if table is None else str(table),
        }  # fmt: skip
        print_json("modes", report)
        return
    for name, rows in listed.items():
        print(
            f"{name} at stop {stop}: {model.strings[name].freq(stop):.2f} Hz, {model.strings[name].tension(stop):.2f} N"
        )
        if len(planes[name]["planes"]) > 1:
            print(f"  planes: {plane_words(planes[name])}")
        print("  partial     freq/Hz    cents    T60/s  share of the body")
        for p in rows:
            print(f"  {p.number:>7} {p.freq:>11.2f} {p.cents:>+8.2f} {p.t60:>8.2f} {100 * p.shares[-1]:>9.1f} %")
        if peaks[name]:
            shown = ", ".join(f"{f:.0f} Hz {decibel(y):.0f} dB" for f, y in peaks[name])
            print(f"  bridge mobility peaks, re 1 (m/s)/N: {shown}")
    for line in touched_lines(touched):
        print(f"left out: {line}")
    for line in facts:
        print(f"body: {line}")
    if named := _body_modes(bundle):
        listing = "  ".join(f"{m['freq']:.0f} ({m['kind']}, Q {m['q']:.0f})" for m in named)
        print(f"body: modes in Hz {listing}")
    for row in wolves:
        print(f"wolf note: {wolf_line(row)}")
    if plot is not None:
        print(f"bridge mobility: {plot}")
    if table is not None:
        print(f"modes of the body: {table}; its first lines are the keys for a bundle")


def _body_modes(bundle: Instrument) -> list[dict[str, Any]]:
    """First modes of a body that knows its whole surface, each with the part that moves most."""
    sources = bundle.body.sources(SHOWN_TO)
    if sources is None:
        return []
    basis = bundle.body.basis(SHOWN_TO)
    rows = [row for row in zip(basis.natural_freq, basis.damping_ratio, sources.labels, strict=False) if row[0] > 0]
    return [{"freq": float(f), "q": float(0.5 / z), "kind": kind} for f, z, kind in rows[:_LISTED]]


def _plot(model: Model, names: list[str], path: Path) -> None:
    """Plot the mobility of the body at each string's end, without strings."""
    import numpy as np

    from tonewood.instrument.inspection.frequencies import bridge_mobility
    from tonewood.physics.plate.figures import COLUMNS, draw_shapes
    from tonewood.support.plotting import SMALL, TEXT, draw_mobility, figure, legend, mobility_figure, save, title

    freq = np.geomspace(40.0, min(10000.0, 0.45 * model.fs), 4000)
    mobility = bridge_mobility(model, freq, names)
    if not mobility:
        raise OutputError("no string of this instrument ends on a body that moves: there is no mobility", file=path)
    marks = [model.strings[name].freq() for name in names]
    heading, sources = model.instrument.spec.title, model.instrument.body.sources(SHOWN_TO)
    if sources is None or not len(sources.areas):
        save(
            mobility_figure(freq, mobility, heading=heading, marks=marks, of="bridge at" if names else "body at"), path
        )
        return
    basis = model.instrument.body.basis(SHOWN_TO)
    page, axes = figure(1 + _LISTED // COLUMNS, COLUMNS, heights=[5.0, *[3.6] * (_LISTED // COLUMNS)])
    for ax in axes[0]:
        ax.remove()
    whole = page.add_subplot(axes[0, 0].get_gridspec()[0, :])
    whole.tick_params(which="both", labelsize=SMALL)
    whole.xaxis.label.set_fontsize(TEXT)
    whole.yaxis.label.set_fontsize(TEXT)
    whole.grid(which="both", color="0.9", lw=0.8)
    draw_mobility(whole, freq, mobility)
    title(whole, heading)
    legend(whole, title="bridge at" if names else "body at", ncols=2)
    moves = basis.natural_freq > 0
    draw_shapes(axes[1:].ravel(), sources.of(moves), basis.natural_freq[moves], 0.5 / basis.damping_ratio[moves])
    save(page, path)
