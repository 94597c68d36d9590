"""``tonewood intonation``: what each fret sounds, and the nut and saddle that even it out."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import AllowCode, BundleName, Json, Overrides, StringSetName, load, print_json
from tonewood.cli.options import render_options
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.instrument.inspection.intonation import Setup, StringIntonation

#: planes that differ by more than this are both printed, cents
_PLANES_DIFFER = 1.0


def intonation(
    instrument: BundleName,
    frets: Annotated[int, typer.Option(help="number of frets that nut and saddle shall even out")] = 12,
    detail: Annotated[
        bool, typer.Option("--detail", help="of every fret the parts of the error, and both planes on the body")
    ] = False,
    fs: Annotated[int, typer.Option(help="sampling rate to assemble it at, Hz")] = 48000,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Print cents by string and fret of INSTRUMENT, by frets, action and strings, and the best nut and saddle.

    Every open string is tuned; `tuning.at: frets` makes renders sound so. Keys: `stops.fretboard`.
    """
    from tonewood.instrument.inspection.intonation import intonation as found_of

    render_options({"fs": fs})
    bundle = load(instrument, settings, allow_code, strings)
    if bundle.spec.stops.kind != "frets":
        raise TonewoodError(f"is {bundle.spec.stops.kind}; frets are wanted", key="stops.kind")
    if not 2 <= frets <= bundle.spec.stops.count:
        raise TonewoodError(f"is {frets}; 2 to {bundle.spec.stops.count} are allowed", key="--frets")
    rows = found_of(bundle, frets=frets, fs=fs)
    if as_json:
        print_json("intonation", {"instrument": bundle.name, "frets": frets, "strings": [_row(s) for s in rows]})
        return
    print(f"{bundle.name}: cents above the note, open strings in tune, on a body that does not move")
    print("  fret" + "".join(f"{s.name:>9}" for s in rows))
    for n in range(max(len(s.stops) for s in rows)):
        cells = [f"{s.stops[n].rigid:>+9.1f}" if n < len(s.stops) else " " * 9 for s in rows]
        print(f"  {n + 1:>4}" + "".join(cells))
    for line in _warnings(rows):
        print(f"  {line}")
    if detail:
        _print_detail(rows)
    else:
        _print_body(rows)
    print(
        f"\nnut and saddle, mm farther out than the scale (less than 0: nearer), and r.m.s. cents of frets 1 to {frets}"
    )
    print("             as built                 best saddle              best nut and saddle")
    print("  string     nut  saddle  r.m.s.      nut  saddle  r.m.s.      nut  saddle  r.m.s.")
    for s in rows:
        print(f"  {s.name:<6}" + "   ".join(_setup(setup) for setup in (s.built, s.saddle_alone, s.both)))
    print("in the bundle: strings.NAME.fretboard: {nut_setback: ..., saddle_setback: ...} in m; tuning: {at: frets}")


def _setup(setup: Setup | None) -> str:
    if setup is None:
        return f"{'none':>24}"
    return f"{1e3 * setup.nut_setback:>+8.2f}{1e3 * setup.saddle_setback:>+8.2f}{setup.rms:>8.2f}"


def _row(s: StringIntonation) -> dict[str, Any]:
    """A string as plain values."""
    setups = {
        key: None if setup is None else {**asdict(setup), "rms": setup.rms}
        for key, setup in (("built", s.built), ("saddle_alone", s.saddle_alone), ("both", s.both))
    }
    stops = [{**asdict(stop), "cents": stop.rigid} for stop in s.stops]
    return {"string": s.name, "tension": s.string.tension, "stops": stops, "setups": setups}


def _warnings(strings: list[StringIntonation]) -> list[str]:
    """Lines about stops at which the string ends on another fret."""
    return [
        f"warning: string {s.name} pressed to fret {stop.stop} lies on fret {stop.rests_on}, which stands out"
        for s in strings
        for stop in s.stops
        if stop.rests_on != stop.stop
    ]


def _print_body(strings: list[StringIntonation]) -> None:
    """The largest shift by the body of each string, and how far its planes are from each other."""
    print("on the body, where it shifts a fret most (--detail: all frets, both planes)")
    for s in strings:
        worst = max(s.stops, key=lambda stop: abs(next(iter(stop.planes.values())) - stop.rigid))
        print(f"  {s.name} fret {worst.stop:>2}: {_planes(worst.planes)} cents, {worst.rigid:+.1f} without the body")


def _planes(planes: dict[str, float]) -> str:
    """Cents of the planes; of the first alone where the others are near."""
    (first, value), *others = [(name.rpartition(".")[2], value) for name, value in planes.items()]
    far = [(name, x) for name, x in others if abs(x - value) > _PLANES_DIFFER]
    return ", ".join(f"{name} {x:+.1f}" for name, x in [(first, value), *far])


def _print_detail(strings: list[StringIntonation]) -> None:
    for s in strings:
        print(f"\n{s.name}: place of the fret + stretch + stiffness; planes on the body")
        for stop in s.stops:
            parts = f"{stop.frets:+7.2f} {stop.stretch:+7.2f} {stop.stiffness:+7.2f} = {stop.rigid:+7.2f}"
            planes = "  ".join(f"{name.rpartition('.')[2]} {x:+.2f}" for name, x in stop.planes.items())
            print(f"  {stop.stop:>4} {parts}   {planes}")
