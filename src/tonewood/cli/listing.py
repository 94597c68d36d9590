"""``tonewood list``: what is installed, and by whom."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from tonewood.cli.common import Json

if TYPE_CHECKING:
    from tonewood.instrument.registry import Entry


def list_installed(as_json: Json = False) -> None:
    """List installed instruments and plugins with the packages they come from."""
    from tonewood import __version__
    from tonewood.instrument import registry
    from tonewood.instrument.bundle import Instrument

    instruments = [
        {
            **_owner(entry),
            "title": (found := Instrument.load(name)).spec.title,
            "licence": found.spec.licence,
            "folder": str(found.folder),
        }
        for name, entry in registry.entries(registry.INSTRUMENTS).items()
    ]
    plugins = []
    for name, entry in registry.entries(registry.PLUGINS).items():
        plugin = registry.plugin(name)
        summary = (plugin.__doc__ or "").strip().partition("\n")[0]
        if "see the module" in summary.lower():
            import sys

            summary = (sys.modules[plugin.__module__].__doc__ or "").strip().partition("\n")[0]
        plugins.append({**_owner(entry), "kind": plugin.kind, "summary": summary})
    if as_json:
        report = {"schema": "tonewood-list/1", "version": __version__, "instruments": instruments, "plugins": plugins}
        print(json.dumps(report))
        return
    print(f"tonewood {__version__}\n\ninstruments")
    for row in instruments:
        print(f"  {row['name']:<20} {row['title']}  [{row['package']} {row['version']}, {row['licence']}]")
    print("\nplugins")
    for row in plugins:
        print(f"  {row['name']:<20} {row['kind']:<10} {row['summary']}  [{row['package']} {row['version']}]")


def _owner(entry: Entry) -> dict[str, str]:
    return {"name": entry.name, "package": entry.distribution, "version": entry.version, "from": entry.value}
