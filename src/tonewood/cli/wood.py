"""``tonewood wood``: constants of a wood from the taps of a free board or stick."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import Json, allow, allow_band, allow_file, allow_word, print_json, warn
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.workshop.wood.board import Board
    from tonewood.workshop.wood.peaks import BoardPeak
    from tonewood.workshop.wood.stick import Stick

#: share of peaks without a mode from which the constants are doubtful
_STRANGERS = 0.25
_NAMES = {"E_L": "GPa", "E_R": "GPa", "G_LR": "GPa", "loss_L": "", "loss_R": "", "loss_shear": ""}


def wood(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILES", help="a table of peaks (.csv, column freq_Hz), or recordings of taps"),
    ],
    length: Annotated[float, typer.Option(help="m, along the grain")],
    width: Annotated[float, typer.Option(help="m, across the grain")],
    thickness: Annotated[float, typer.Option(help="m; of a stick the side across which it bends")],
    mass: Annotated[float, typer.Option(help="kg")],
    species: Annotated[str, typer.Option(help="whose Poisson's ratio and shear through the thickness are taken")] = (
        "sitka_spruce"
    ),
    stick: Annotated[bool, typer.Option("--stick", help="a brace stick: E_L alone, from its bending")] = False,
    thickness_error: Annotated[float, typer.Option(help="m, standard deviation of the thickness")] = 5e-5,
    sensor: Annotated[
        float | None,
        typer.Option(help="kg, mass of a sensor at a corner, 0 for a microphone; sought, and stated, where left out"),
    ] = None,
    band: Annotated[tuple[float, float], typer.Option(metavar="LOW HIGH", help="Hz, band of the peaks")] = (
        30.0,
        800.0,
    ),
    outline: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="LENGTH UPPER WAIST LOWER", help="m, of a guitar's top, for its thickness"),
    ] = None,
    stiffness: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="lowest frequency that the bare top is to have, clamped at its outline"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="write `wood:` for a drawn body (.yaml)")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find E_L, E_R, G_LR and losses of a board that hangs or lies freely, with intervals of 90 %."""
    from tonewood.physics.plate.wood import SPECIES
    from tonewood.support.whole_files import write_whole
    from tonewood.workshop.wood.board import typical
    from tonewood.workshop.wood.peaks import read_peaks

    sizes = {"--length": length, "--width": width, "--thickness": thickness}
    for key, value in sizes.items():
        _in_si(key, value, 5e-4, 3.0, ("m", "mm"))
    if thickness > max(length, width):
        raise TonewoodError(
            f"is {thickness:g} m, more than --length and --width; metres are expected, and {thickness:g} mm are "
            f"{thickness / 1000:g}",
            key="--thickness",
        )
    _in_si("--mass", mass, 1e-4, 100.0, ("kg", "g"))
    allow("--thickness-error", thickness_error, 1e-7, 0.2 * thickness, "m")
    if sensor is not None:
        allow("--sensor", sensor, 0.0, 0.1 * mass, "kg")
    allow_band(band)
    density = mass / (length * width * thickness)
    if not 80 < density < 1500:
        raise TonewoodError(
            f"{density:.0f} kg/m^3 is no wood: are --length, --width and --thickness in m and --mass in kg "
            f"({mass:g} g are {mass / 1000:g})?",
            key="--mass",
        )
    allow_word("--species", species, SPECIES)
    if stiffness is not None and outline is None:
        raise TonewoodError("needs --outline LENGTH UPPER WAIST LOWER", key="--stiffness")
    for value in outline or ():
        allow("--outline", value, 0.01, 3.0, "m")
    if stick and outline is not None:
        raise TonewoodError("is for a board; a stick has no E_R and G_LR", key="--outline")
    allow_file("--output", output, ".yaml")
    peaks, outside = read_peaks(files, band)
    nominal = typical(species, density)
    try:
        solution = _stick(sizes, mass, peaks, nominal.G_LT / nominal.E_L, thickness_error) if stick else _board(
            sizes, mass, peaks, species, thickness_error, sensor
        )  # fmt: skip
        tops = _tops(solution, outline, stiffness)
    except ValueError as fault:
        raise TonewoodError(str(fault), file=files[0]) from None
    report = _report(solution, density, tops, sensor is None)
    if outside:
        shown = ", ".join(f"{f:.1f}" for f in outside)
        report["warnings"].append(f"peaks outside --band {band[0]:g} {band[1]:g} were not used: {shown} Hz")
    if output is not None:
        write_whole(output, _yaml(solution, species))
        report["written"] = str(output)
    if as_json:
        print_json("wood", report)
        return
    warn(report["warnings"])
    _print(report)


def _in_si(key: str, value: float, low: float, high: float, units: tuple[str, str]) -> None:
    """Refuse a value outside its range; where a thousandth of it is allowed, say so: mm and g are near at hand."""
    try:
        allow(key, value, low, high, units[0])
    except TonewoodError as fault:
        if not low <= value / 1000 <= high:
            raise
        raise TonewoodError(f"{fault.reason}; {value:g} {units[1]} are {value / 1000:g} {units[0]}", key=key) from None


def _board(
    sizes: dict[str, float], mass: float, peaks: list[BoardPeak], species: str, error: float, sensor: float | None
) -> Board:
    from tonewood.workshop.wood.board import estimate_board, typical
    from tonewood.workshop.wood.rectangle import Rectangle

    length, width, thickness = sizes.values()
    nominal = typical(species, mass / (length * width * thickness))
    plate = Rectangle.of(length, width, thickness, mass, nominal)
    freq, errors, q = [p.freq for p in peaks], [p.error for p in peaks], [p.q for p in peaks]
    first = estimate_board(plate, freq, errors, q, thickness_error=error, sensor=sensor)
    plate = Rectangle.of(length, width, thickness, mass, first.wood)
    return estimate_board(plate, freq, errors, q, thickness_error=error, prior=nominal, sensor=sensor)


def _stick(sizes: dict[str, float], mass: float, peaks: list[BoardPeak], ratio: float, error: float) -> Stick:
    from tonewood.workshop.wood.stick import estimate_stick

    length, width, height = sizes.values()
    freq, errors, q = [p.freq for p in peaks], [p.error for p in peaks], [p.q for p in peaks]
    return estimate_stick(length, width, height, mass, freq, errors, q, shear_ratio=ratio, thickness_error=error)


def _tops(
    solution: Board | Stick, outline: tuple[float, float, float, float] | None, stiffness: float | None
) -> list[dict[str, Any]]:
    """Thickness and lowest frequency of tops of this board."""
    from tonewood.physics.plate.outline import guitar_outline
    from tonewood.workshop.wood.board import Board
    from tonewood.workshop.wood.thickness import TARGETS, gore_thickness, panel_freq, thickness_for

    if outline is None or not isinstance(solution, Board):
        return []
    wood, ring, (length, _, _, lower) = solution.wood, guitar_outline(*outline), outline
    here = "bare and clamped at its outline"
    if stiffness is not None:
        tops = [(thickness_for(wood, ring, stiffness), stiffness, here)]
    else:
        tops = [(1e-3 * h, panel_freq(wood, ring, 1e-3 * h), here) for h in (2.0, 2.5, 3.0)]
    for name, freq in TARGETS.items():
        kind = f"Gore and Gilet's target of a {name.replace('_', ' ')}, a clamped rectangle"
        tops.append((gore_thickness(wood, length, lower, freq), freq, kind))
    return [{"thickness_m": h, "freq_Hz": freq, "of": kind} for h, freq, kind in tops]


def _report(solution: Board | Stick, density: float, tops: list[dict[str, Any]], sought: bool) -> dict[str, Any]:
    from tonewood.workshop.wood.board import Board

    warnings = []
    if isinstance(solution, Board):
        pairs = [{"measured_Hz": p.measured, "computed_Hz": p.computed, "kind": p.kind} for p in solution.pairs]
        if solution.sensor and sought:
            warnings.append(
                f"a sensor of {1e3 * solution.sensor:.1f} g at a corner explains the peaks better and was taken into "
                "account: state its mass by --sensor, 0 if there was none"
            )
        strangers = len(solution.peaks_without_mode)
        if strangers >= _STRANGERS * (strangers + len(pairs)):
            warnings.append(
                f"{strangers} of {strangers + len(pairs)} peaks are no mode of such a board: do not trust the "
                "constants or their intervals before sizes (length is along the grain), mass and peaks are checked"
            )
        if solution.misfit > 0.012:
            warnings.append(
                f"peaks and modes differ by {100 * solution.misfit:.1f} %: wrong size, mass or thickness, or a board "
                "that was not free, are the usual causes; the intervals are wider for it"
            )
    else:
        pairs = [
            {"measured_Hz": a, "computed_Hz": b, "kind": "bending along"}
            for a, b in zip(solution.measured, solution.computed, strict=True)
        ]
    if solution.peaks_without_mode:
        some = ", ".join(f"{f:.1f}" for f in solution.peaks_without_mode)
        warnings.append(f"peaks that are no mode of such a board: {some} Hz")
    values = {
        key: {
            "value": getattr(solution.wood if isinstance(solution, Board) else solution, key),
            "interval_90": list(ends),
        }
        for key, ends in solution.intervals.items()
    }
    return {
        "density": density, "sensor_kg": getattr(solution, "sensor", 0.0), "constants": values, "pairs": pairs,
        "peaks_without_mode_Hz": list(solution.peaks_without_mode),
        "modes_without_peak_Hz": list(getattr(solution, "modes_without_peak", ())), "tops": tops, "warnings": warnings,
    }  # fmt: skip


def _print(report: dict[str, Any]) -> None:
    print(f"density {report['density']:.0f} kg/m^3")
    for key, entry in report["constants"].items():
        unit = _NAMES[key]
        scale = 1e-9 if unit else 1.0
        value, low, high = (scale * x for x in (entry["value"], *entry["interval_90"]))
        print(f"{key:<11} {value:8.4g}  {low:.4g} to {high:.4g} {unit}".rstrip())
    print("  measured/Hz  computed/Hz       %  mode")
    for pair in report["pairs"]:
        percent = 100 * (pair["computed_Hz"] / pair["measured_Hz"] - 1)
        print(f"{pair['measured_Hz']:>13.2f} {pair['computed_Hz']:>12.2f} {percent:>+7.2f}  {pair['kind']}")
    if report["modes_without_peak_Hz"]:
        print("modes without a peak: " + ", ".join(f"{f:.0f}" for f in report["modes_without_peak_Hz"]) + " Hz")
    for top in report["tops"]:
        print(f"{1e3 * top['thickness_m']:.2f} mm: {top['freq_Hz']:.1f} Hz, {top['of']}")
    print("intervals are of 90 %; Poisson's ratio and the shear through the thickness lean on those of the species")
    if "written" in report:
        print(f"written: {report['written']}")


def _yaml(solution: Board | Stick, species: str) -> str:
    """The constants as a drawn body takes them."""
    from tonewood.workshop.wood.board import Board

    if isinstance(solution, Board):
        w = solution.wood
        values = {"E_L": w.E_L, "E_R": w.E_R, "G_LR": w.G_LR, "G_LT": w.G_LT, "G_RT": w.G_RT, "nu_LR": w.nu_LR}
        losses = {k: getattr(w, k) for k in ("loss_L", "loss_R", "loss_shear")}
        values |= losses if any(losses.values()) else {}
    else:
        values = {"E_L": solution.E_L} | ({} if solution.loss_L is None else {"loss_L": solution.loss_L})
    density = solution.wood.density if isinstance(solution, Board) else solution.density
    lines = [f"  {key}: {value:.4g}" for key, value in ({"density": density} | values).items()]
    ends = "; ".join(f"{k} {a:.4g} to {b:.4g}" for k, (a, b) in solution.intervals.items())
    return (
        "\n".join([f"# from taps of a free board; intervals of 90 %: {ends}", "wood:", f"  species: {species}", *lines])
        + "\n"
    )
