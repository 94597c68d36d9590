"""``tonewood strings``: materials and sets of strings that can be bought, and the figures that follow from them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import Json, allow, print_json, string_set_names

if TYPE_CHECKING:
    from tonewood.instrument.bundle.schema import StringSet

_POUND = 4.4482216


def strings_for_sale(
    name: Annotated[
        str | None, typer.Argument(metavar="[SET]", help="name of a string set", autocompletion=string_set_names)
    ] = None,
    length: Annotated[float | None, typer.Option(help="speaking length, m; that of the set where left out")] = None,
    as_json: Json = False,
) -> None:
    """List string sets and materials; of one SET the tension, mass and stiffness of each string.

    A string of a bundle takes gauge and material by its key `made_of`, a whole set is put on by `--strings SET`.
    """
    from tonewood.instrument.bundle.string_materials import string_materials
    from tonewood.instrument.bundle.string_sets import string_set, string_sets

    if length is not None:
        allow("--length", length, 0.02, 5.0, "m")
    if name is not None:
        rows = _rows(string_set(name), length)
        if as_json:
            print_json("strings", {"set": name, "strings": rows})
        else:
            _print_set(name, string_set(name), rows)
        return
    sets, materials = string_sets(), string_materials()
    if as_json:
        listed = {key: material.model_dump(mode="json", exclude_none=True) for key, material in materials.items()}
        print_json("strings", {"sets": list(sets), "materials": listed})
        return
    print("string sets (tonewood strings SET)")
    for key, one in sets.items():
        print(f"  {key:<20} {one.maker} {one.product} ({' '.join(entry.note for entry in one.strings)})")
    print("\nmaterials (strings.NAME.made_of; `wound` has a core of the first three and a wrap)")
    for key, material in materials.items():
        stiff = ", for wraps"
        if (young := material.young) is not None:
            rising = f" + {young.per_stress:g} times the stress" if young.per_stress else ""
            stiff = f", E {1e-9 * young.value:.4g} GPa{rising}"
        print(f"  {key:<20} {material.title}: {material.density.value:g} kg/m^3{stiff}")
        figures = (material.density, material.young, material.young_slow, material.core_share)
        for source in dict.fromkeys(x.source for x in (*figures, material.loss, material.loss_as_core) if x):
            print(f"    {source}")


def _rows(chosen: StringSet, length: float | None) -> list[dict[str, Any]]:
    """Figures of each string at its note."""
    from tonewood.instrument.bundle.string_sets import figures
    from tonewood.instrument.scales import note_number

    out = []
    for entry in chosen.strings:
        at = length or entry.length or chosen.length
        freq = 440.0 * 2 ** ((note_number(entry.note) - 69) / 12)
        diameter = entry.diameter or (entry.made_of.diameter if entry.made_of else None)
        material = entry.made_of.material if entry.made_of else None
        values = figures(entry, chosen, at, freq)
        out.append({"note": entry.note, "length": at, "diameter": diameter, "material": material, **values})
    return out


def _print_set(name: str, chosen: StringSet, rows: list[dict[str, Any]]) -> None:
    print(f"{name}: {chosen.maker} {chosen.product}\n  {chosen.source.text}")
    print("  note  d/mm  inch   material        g/m  tension/N    lb   EI/uN m^2     EA/N  EA slow/N")
    for row in rows:
        d = row["diameter"]
        size = "   -     - " if d is None else f"{1e3 * d:5.3f} {d / 0.0254:6.4f}"
        stiff = [row.get(key) for key in ("bending_stiffness", "axial_stiffness", "fretting_stiffness")]
        cells = [f"{(1e6 if i == 0 else 1) * x:>10.0f}" if x is not None else f"{'-':>10}" for i, x in enumerate(stiff)]
        print(
            f"  {row['note']:<4} {size}  {row['material'] or '-':<12} {1e3 * row['linear_density']:>7.4f} "
            f"{row['tension']:>10.2f} {row['tension'] / _POUND:>5.1f} {''.join(cells)}"
        )
    total = sum(row["tension"] for row in rows)
    print(f"  together {total:.1f} N, {total / _POUND:.1f} lb")
