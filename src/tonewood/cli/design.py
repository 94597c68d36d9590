"""``tonewood design``: find the change with which a body reaches its targets."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import AllowCode, BundleName, Json, Overrides, StringSetName, load, print_json
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.workshop.design.search import FoundDesign


def design(
    instrument: BundleName,
    task: Annotated[
        Path | None, typer.Argument(metavar="[TASK.yaml]", help="targets and free parameters, as lines")
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TARGET",
            help="'T1 = 200', 'A0 <= 100', 'mode 3 >= 290' (Hz), 'mobility POINT 80..1000 >= -30' (dB re 1 m/s/N), "
            "'no wolf F3..A3', 'mass <= 0.2' (kg); may be given again",
        ),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=LOW:HIGH",
            help="number of the body that may change, 'body.thickness=2e-3:3e-3'; x0.7:1.4 is a factor on all numbers "
            "below the path, +-0.02:0.02 is added to them; strings=SET,SET tries string sets; may be given again",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="write the design as a bundle to FOLDER")
    ] = None,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> int:
    """Find the least change of INSTRUMENT's body that reaches targets, and say what trades with what.

    Exit code 1 if a target cannot be reached within the bounds.
    """
    from tonewood.workshop.design.folder import check_folder, write_design
    from tonewood.workshop.design.search import find_design
    from tonewood.workshop.design.task import parse_free, parse_targets, read_task
    from tonewood.workshop.design.words import lines

    texts, parameters = read_task(task) if task is not None else ([], {})
    texts = texts + list(target or ())
    bounds: dict[str, str] = {}
    for text in free or ():
        path, equals, ends = (part.strip() for part in text.partition("="))
        if not equals or not path:
            raise TonewoodError(f"is {text!r}; PATH=LOW:HIGH is allowed", key="--free")
        if path in bounds:
            raise TonewoodError("is there twice; once is allowed", key=f"--free {path}")
        bounds[path] = ends
    parameters |= bounds  # the command line decides over the file
    if output is not None:
        check_folder(output)
    sets = [name.strip() for name in parameters.pop("strings", "").split(",") if name.strip()]
    if sets and strings is not None:
        raise TonewoodError(
            f"stands beside --free strings={','.join(sets)}; one of the two is allowed", key="--strings"
        )
    tried: list[str | None] = [*sets] or [strings]
    bundles = [load(instrument, settings, allow_code, name) for name in tried]
    tasks = [
        (bundle, parse_targets(texts, bundle), parse_free(parameters, bundle) if parameters or not sets else [])
        for bundle in bundles
    ]
    designs = [find_design(*each, lambda line: print(f"design: {line}", file=sys.stderr, flush=True)) for each in tasks]
    best = min(designs, key=lambda design: design.cost)
    chosen = tried[designs.index(best)]
    if output is not None:
        write_design(best, output)
    if as_json:
        print_json("design", {**_report(best, output), "strings": chosen}, ok=best.ok)
        return 0 if best.ok else 1
    for name, design in zip(sets, designs, strict=False):
        missed = [t.text for t, off in zip(design.targets, design.off, strict=True) if abs(off) > t.tolerance]
        print(f"strings {name}: {'misses ' + '; '.join(missed) if missed else 'reach all targets'}")
    for line in [*([f"with strings {chosen}"] if sets else []), *lines(best)]:
        print(line)
    options = [f"--strings {chosen}"] if chosen else []
    options += [f"--set {path}={value:.6g}" for path, value in _overrides(best).items()]
    print(f"for render and compare: {' '.join(options)}")
    if output is not None:
        print(f"bundle: {output}")
    return 0 if best.ok else 1


def _overrides(best: FoundDesign) -> dict[str, float]:
    out: dict[str, float] = {}
    for parameter, value in zip(best.free, best.values, strict=True):
        out |= parameter.overrides(float(value))
    return out


def _report(best: FoundDesign, output: Path | None) -> dict[str, Any]:
    from tonewood.workshop.design.words import at_bounds, lines, trades

    return {
        "instrument": best.instrument.name,
        "parameters": [
            {"path": p.name, "keys": list(p.paths), "kind": p.kind, "low": p.low, "high": p.high, "now": float(b),
             "designed": float(v)}
            for p, b, v in zip(best.free, best.before, best.values, strict=True)
        ],
        "targets": [
            {"text": t.text, "now": float(g), "designed": float(r), "off": float(o), "unit": t.unit,
             "reached": abs(float(o)) <= t.tolerance, "rates": [float(x) for x in row]}
            for t, g, r, o, row in zip(best.targets, best.initial, best.reached, best.off, best.rates, strict=True)
        ],
        "overrides": _overrides(best),
        "trades": trades(best),
        "at_bounds": at_bounds(best),
        "lines": list(lines(best)),
        "bundle": None if output is None else str(output),
    }  # fmt: skip
