"""``tonewood list``: installed instruments, plugins, and string sets."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from tonewood.cli.common import AllowCode, Json, print_json
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.instrument.contract.registry import Entry


def list_installed(allow_code: AllowCode = False, as_json: Json = False) -> None:
    """List installed instruments and plugins with the packages they come from, and the string sets that are known."""
    from tonewood import __version__
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.instrument.bundle.string_sets import string_sets
    from tonewood.instrument.contract import registry

    instruments: list[dict[str, str]] = []
    for name, entry in registry.entries(registry.INSTRUMENTS).items():
        try:
            one = Instrument.load(name, allow_code=allow_code)
        except TonewoodError as fault:
            instruments.append({**_owner(entry), "broken": str(fault)})
            continue
        more = {"title": one.spec.title, "licence": one.spec.licence, "folder": str(one.folder)}
        instruments.append({**_owner(entry), **more})
    plugins: list[dict[str, str]] = []
    broken = registry.broken_plugins()
    for name, entry in registry.entries(registry.PLUGINS).items():
        if name in broken:
            plugins.append({**_owner(entry), "broken": broken[name]})
            continue
        plugin = registry.plugin(name)
        summary = (plugin.__doc__ or "").strip().partition("\n")[0]
        if "see the module" in summary.lower():
            summary = (sys.modules[plugin.__module__].__doc__ or "").strip().partition("\n")[0]
        plugins.append({**_owner(entry), "kind": plugin.kind, "summary": summary})
    sets = [
        {"name": name, "maker": one.maker, "product": one.product, "notes": [e.note for e in one.strings]}
        for name, one in string_sets().items()
    ]
    if as_json:
        report = {"version": __version__, "instruments": instruments, "plugins": plugins, "string_sets": sets}
        print_json("list", report)
        return
    print(f"tonewood {__version__}\n\ninstruments")
    for row in instruments:
        print(
            _line(row) or f"  {row['name']:<20} {row['title']}  [{row['package']} {row['version']}, {row['licence']}]"
        )
    print("\nplugins")
    for row in plugins:
        print(
            _line(row) or f"  {row['name']:<20} {row['kind']:<10} {row['summary']}  [{row['package']} {row['version']}]"
        )
    print("\nstring sets (`tonewood strings` has their figures, and the materials of strings)")
    for chosen in sets:
        print(f"  {chosen['name']:<20} {chosen['maker']} {chosen['product']} ({' '.join(chosen['notes'])})")


def _line(row: dict[str, str]) -> str:
    """Line of an instrument or plugin that cannot be used; empty for any other."""
    return f"  {row['name']:<20} broken: {row['broken']}" if "broken" in row else ""


def _owner(entry: Entry) -> dict[str, str]:
    return {"name": entry.name, "package": entry.distribution, "version": entry.version, "from": entry.value}
