"""An instrument as its bundle describes it: YAML and tables, checked and resolved, nothing computed yet."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from tonewood.errors import BundleError, OldFormatWarning, PluginError, ScoreError, TonewoodError, kind_of
from tonewood.instrument.bundle.added import body_parts
from tonewood.instrument.bundle.identity import content_hash, plugin_hashes
from tonewood.instrument.bundle.keys import groups, key_exciters, merged, with_keys
from tonewood.instrument.bundle.migration import bundle_edits
from tonewood.instrument.bundle.origins import Origins
from tonewood.instrument.bundle.overrides import apply_overrides
from tonewood.instrument.bundle.references import check_references
from tonewood.instrument.bundle.schema import Bundle, OutputPart, PluginPart
from tonewood.instrument.bundle.string_sets import with_materials, with_set
from tonewood.instrument.contract import registry
from tonewood.instrument.contract.base import Attachment, Body, Exciter, Loss, Pickup, Plugin, Resonator
from tonewood.instrument.contract.bundle_code import plugin_named
from tonewood.instrument.contract.directions import polarization_vectors
from tonewood.instrument.contract.files import Files
from tonewood.instrument.scales import Tuning, note_number, read_tuning
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.views import SHOWN_TO, ModalViews
from tonewood.support.garbage import without_collecting
from tonewood.support.params import Vector, validated
from tonewood.support.tables import properties_html
from tonewood.support.yaml_edit import apply_edits
from tonewood.support.yaml_io import load_yaml, located


@dataclass(frozen=True, eq=False)
class Instrument(ModalViews):
    """A checked bundle with its plugins; immutable, `replace` makes another one.

    Attributes
    ----------
    folder : of the bundle.
    spec : every key of the bundle, defaults filled in.
    body : plugin of the body, to which the strings are joined.
    resonators : string -> its plugin.
    exciters : name -> plugin.
    attachments : name -> plugin of frets, a curved bridge, loose parts.
    pickups : output group -> plugin.
    key_exciters : key -> the exciter that `keys` names, with the parameters of that key.
    resolved : all keys as plain values (JSON), plugins' defaults included; `replace` changes these.
    granted : files outside the folder that overrides have named.
    allow_code : whether plugins in the bundle's folder may run.
    """

    folder: Path
    spec: Bundle
    body: Body[Any]
    resonators: Mapping[str, Resonator[Any]]
    exciters: Mapping[str, Exciter[Any]]
    attachments: Mapping[str, Attachment[Any]]
    pickups: Mapping[str, Pickup[Any]]
    resolved: Mapping[str, Any]
    granted: frozenset[Path] = frozenset()
    allow_code: bool = False
    key_exciters: Mapping[str, Exciter[Any]] = field(default_factory=dict)

    def __repr__(self) -> str:
        strings = ", ".join(self.resonators)
        return f"Instrument({self.name!r}, body {self.spec.body.plugin}, strings {strings})"

    def _repr_html_(self) -> str:
        spec = self.spec
        strings = ", ".join(f"{name} ({part.note or part.freq})" for name, part in spec.strings.items())
        rows = {
            "name": self.name,
            "body": spec.body.plugin,
            "strings": strings,
            "stops": f"{spec.stops.kind}, {spec.stops.count}" if spec.stops.count else "none",
            "exciters": ", ".join(spec.exciters),
            "outputs": ", ".join(part.name for part in spec.outputs),
            "licence": spec.licence,
            "stand-ins": ", ".join(self.origins.stand_ins()) or "none",
        }
        return properties_html(spec.title, rows)

    def _viewed(self) -> tuple[ModalBasis, Mapping[str, str]]:
        """Modes of the body with the parts added to it, and the point that each string ends on."""
        body, manifest = self.body.basis(SHOWN_TO), self._files.manifest
        whole = body_parts(self.spec.body.added, body, self.body.points(), manifest).body
        ends = {name: part.body_points[0] for name, part in self.spec.strings.items()}
        return whole, ends or {name: name for name in self.body.points()}

    def _view_title(self) -> str:
        return self.spec.title

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str], *, allow_code: bool = False) -> Instrument:
        """Load an installed instrument by name, or a folder with an ``instrument.yaml``.

        Parameters
        ----------
        name_or_path : name as `tonewood list` prints it, or path of the folder.
        allow_code : run plugins that lie as Python files in the bundle's folder; without it such a bundle is refused.

        Raises
        ------
        BundleError, PluginError : one line with file, key and reason.

        Warns
        -----
        OldFormatWarning : the bundle is of an earlier schema; it is read as `tonewood migrate` would rewrite it.
        """
        if not isinstance(name_or_path, str | os.PathLike):
            raise BundleError(f"is {kind_of(name_or_path)}; a name or a folder is allowed", key="instrument")
        folder = registry.instrument_folder(name_or_path)
        manifest = folder / registry.MANIFEST
        try:
            return cls.from_values(load_yaml(manifest, error=BundleError), folder, allow_code=allow_code)
        except TonewoodError as fault:
            raise located(fault) from None

    @classmethod
    def from_values(
        cls,
        values: Mapping[str, Any],
        folder: str | os.PathLike[str],
        granted: frozenset[Path] = frozenset(),
        *,
        allow_code: bool = False,
    ) -> Instrument:
        """Make one from nested plain values, as they stand in an ``instrument.yaml``.

        Parameters
        ----------
        values : key -> value.
        folder : from which tables are read.
        granted : other files that may be read.
        allow_code : as for `load`.

        Raises
        ------
        BundleError, PluginError : one line with file, key and reason.
        """
        root = Path(folder)
        files = Files(root, root / registry.MANIFEST, granted, allow_code)
        if edits := bundle_edits(values, files.manifest):
            what = f"{files.manifest}: schema: {values['schema']} is deprecated; run: tonewood migrate {root}"
            warnings.warn(what, OldFormatWarning, stacklevel=3)
            values = apply_edits(values, edits)
        rows = with_keys(values, files)
        try:
            return cls._of_values(rows.values, files)
        except (BundleError, PluginError) as fault:
            raise rows.located(fault) from None

    @classmethod
    def _of_values(cls, values: Mapping[str, Any], files: Files) -> Instrument:
        """Make one from the values of a bundle whose table of keys is expanded."""
        spec = validated(Bundle, _with_strings(_merged(values, files), files), key="", file=files.manifest)
        parts = _parts(spec, files)
        instrument = cls(
            folder=files.root or Path(), spec=spec, **parts, resolved=_resolved(spec, parts), granted=files.granted,
            allow_code=files.allow_code,
        )  # fmt: skip
        points = [name for name, point in instrument.body.points().items() if point.driven]
        check_references(spec, points, instrument.exciters, instrument.folder / registry.MANIFEST, instrument.open_note)
        for name in spec.strings:
            instrument.polarizations(name)
        return instrument

    def replace(self, overrides: Mapping[str, Any]) -> Instrument:
        """Return the instrument with some values changed.

        Parameters
        ----------
        overrides : path -> value, ``{"scale": x}`` or ``{"fraction": x}``; see `overrides`. ``strings_from`` puts
            another string set on, before anything else is changed. A scale or keymap may be
            any file that the caller may read, while a bundle is confined to its folder.

        Raises
        ------
        BundleError : a path is unknown, or a value is not allowed; one line.

        Examples
        --------
        >>> guitar = Instrument.load("classical_guitar")
        >>> lower = guitar.replace({"strings.E2.note": "D2", "strings.*.loss.eta_a": {"scale": 1.5}})
        >>> lower.resolved["strings"]["E2"]["note"]
        'D2'
        """
        if not isinstance(overrides, Mapping):
            raise BundleError(f"is {kind_of(overrides)}; a mapping of path to value is allowed", key="overrides")
        if not overrides:
            return self
        if "keys.table" in overrides:
            raise BundleError("cannot be changed; `tonewood new` makes a bundle of your own", key="keys.table")
        changes, granted = _outside_files(overrides, self.folder)
        values = dict(self.resolved)
        if (strings := changes.get("strings_from")) is not None:
            values = with_set(values, str(strings), over=True, file=self._files.manifest)
        bought = {path: value for path, value in changes.items() if ".made_of" in path}
        before, values = values["strings"], apply_overrides(values, bought, file=self._files.manifest)
        changed = [k for k, part in values["strings"].items() if part["made_of"] != before.get(k, {}).get("made_of")]
        values = with_materials(values, over=changed, file=self._files.manifest)
        others = {path: value for path, value in changes.items() if path not in bought}
        values = apply_overrides(values, others, file=self._files.manifest)
        return Instrument.from_values(values, self.folder, self.granted | granted, allow_code=self.allow_code)

    @property
    def name(self) -> str:
        """Name of the instrument, as on the command line."""
        return self.spec.name

    @property
    def string_names(self) -> tuple[str, ...]:
        """Strings from bass to treble."""
        return tuple(self.spec.strings)

    @cached_property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """String that gives the pitch -> the strings that a note on it plays: those of its key, or itself alone."""
        return groups(self.spec)

    @cached_property
    def key_of(self) -> Mapping[str, str]:
        """String -> its key, of those that have one."""
        entries = self.spec.keys.entries if self.spec.keys else {}
        return {string: name for name, key in entries.items() for string in key.strings}

    def exciter(self, name: str, string: str) -> Exciter[Any]:
        """Return the exciter of a name as it plays a string: with the parameters of the string's key."""
        if self.spec.keys is not None and name == self.spec.keys.exciter:
            return self.key_exciters.get(self.key_of.get(string, ""), self.exciters[name])
        return self.exciters[name]

    @property
    def plugins(self) -> tuple[Plugin[Any], ...]:
        """Plugins of all parts."""
        parts = (self.resonators, self.exciters, self.attachments, self.pickups)
        return (self.body, *(plugin for group in parts for plugin in group.values()))

    @cached_property
    def tuning(self) -> Tuning:
        """Frequencies of notes."""
        part = self.spec.tuning
        scale = None if part.scale == "equal_12" else self._files.path(part.scale, "tuning.scale")
        keymap = None if part.keymap is None else self._files.path(part.keymap, "tuning.keymap")
        return read_tuning(scale, keymap, reference_freq=part.reference_freq)

    def open_note(self, string: str) -> float:
        """Return the note number of an open string, fractional where it is given by its frequency."""
        part = self.spec.strings[string]
        try:
            if part.freq is not None:
                return self.tuning.note(part.freq)
            note = float(note_number(part.note)) if isinstance(part.note, str) else float(part.note or 0.0)
            self.tuning.freq(note)
            return note
        except ScoreError as fault:
            raise self._fault(fault.reason, f"strings.{string}.note") from None

    def polarizations(self, string: str) -> tuple[Vector, ...]:
        """Return the directions in which a string moves, tilt included."""
        part = self.spec.strings[string]
        size = sum(x * x for x in part.axis) ** 0.5
        if abs(size - 1.0) > 1e-2:
            raise self._fault(f"has length {size:.4g}; a vector of length 1 is wanted", f"strings.{string}.axis")
        try:
            return polarization_vectors(part.axis, tuple(part.polarizations), part.tilt_deg + part.scatter.tilt(string))
        except ValueError as fault:
            raise self._fault(str(fault), f"strings.{string}.polarizations") from None

    @property
    def origins(self) -> Origins:
        """Where its figures come from."""
        return Origins(self.spec.provenance, self.resolved, self._files)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 over the resolved values, the bundle's other files, and the plugins' sources."""
        return content_hash(self.resolved, self.folder, self.granted, self.plugin_hashes)

    @property
    def plugin_hashes(self) -> dict[str, str]:
        """Plugin -> SHA-256 of its source file, as it is run; of an installed one with its distribution's version."""
        return plugin_hashes(self._named_plugins())

    def _named_plugins(self) -> Iterator[tuple[str, Plugin[Any]]]:
        """Name and plugin of every part, and of the loss laws of strings."""
        spec = self.spec
        yield spec.body.plugin, self.body
        yield from ((spec.strings[name].plugin, plugin) for name, plugin in self.resonators.items())
        yield from (
            (law.law, law) for plugin in self.resonators.values() for law in plugin.inner if isinstance(law, Loss)
        )
        yield from ((spec.connections[name].plugin, plugin) for name, plugin in self.attachments.items())
        yield from ((spec.exciters[name].plugin, plugin) for name, plugin in self.exciters.items())
        yield from ((part.plugin, self.pickups[part.name]) for part in spec.outputs)

    @property
    def plugin_names(self) -> tuple[str, ...]:
        """Plugins the bundle uses, each once."""
        return tuple(dict.fromkeys(name for name, _ in self._named_plugins()))

    @property
    def _files(self) -> Files:
        return Files(self.folder, self.folder / registry.MANIFEST, self.granted)

    def _fault(self, reason: str, key: str) -> BundleError:
        return BundleError(reason, file=self._files.manifest, key=key)


def _outside_files(overrides: Mapping[str, Any], folder: Path) -> tuple[dict[str, Any], frozenset[Path]]:
    """Overrides with whole paths of a scale or keymap that is not in the folder, and these paths."""
    inside, outside = dict(overrides), set()
    for key in ("tuning.scale", "tuning.keymap"):
        value = inside.get(key)
        with suppress(OSError, ValueError):  # a name too long or with a zero byte: `Files.path` refuses it
            if not isinstance(value, str) or (not Path(value).is_absolute() and (folder / value).is_file()):
                continue
            if Path(value).is_file():
                inside[key] = str(Path(value).resolve())
                outside.add(Path(value).resolve())
    return inside, frozenset(outside)


def _parts(spec: Bundle, files: Files) -> dict[str, Any]:
    """Plugins of a bundle, by the attributes of `Instrument` that hold them; the registry checks their kinds."""

    def make(part: PluginPart, kind: str, key: str) -> Plugin[Any]:
        try:
            plugin = plugin_named(part.plugin, kind, files)
        except PluginError as fault:
            raise PluginError(fault.reason, file=files.manifest, key=f"{key}.plugin") from None
        return plugin.from_values(part.values, files, key)

    def each(parts: Mapping[str, PluginPart], kind: str, key: str) -> dict[str, Plugin[Any]]:
        return {name: make(part, kind, f"{key}.{name}") for name, part in parts.items()}

    body = make(spec.body, "body", "body")
    resonators = each(spec.strings, "resonator", "strings")
    exciters = each(spec.exciters, "exciter", "exciters")
    by_key = {
        name: make(part, "exciter", f"keys.{name}.{played}")
        for name, played, part in key_exciters(spec, files.manifest)
    }
    attachments = each(spec.connections, "connection", "connections")
    pickups = each({part.name: part for part in spec.outputs}, "pickup", "outputs")
    return {
        "body": body, "resonators": resonators, "exciters": exciters, "key_exciters": by_key,
        "attachments": attachments, "pickups": pickups,
    }  # fmt: skip


def _resolved(spec: Bundle, parts: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a bundle with every default written out."""

    def flat(part: PluginPart, plugin: Plugin[Any]) -> dict[str, Any]:
        common = part.model_dump(mode="json", by_alias=True, include=set(type(part).model_fields))
        return {**common, **plugin.parameters.model_dump(mode="json", by_alias=True)}

    values = spec.model_dump(mode="json", by_alias=True) | {"body": flat(spec.body, parts["body"])}
    for key, kind in (("strings", "resonators"), ("exciters", "exciters"), ("connections", "attachments")):
        values[key] = {name: flat(getattr(spec, key)[name], plugin) for name, plugin in parts[kind].items()}
    return values | {"outputs": [flat(part, parts["pickups"][part.name]) for part in spec.outputs]}


def _merged(values: Mapping[str, Any], files: Files) -> dict[str, Any]:
    """Merge `strings.defaults` into every string, whose own keys go first."""
    out = dict(values)
    strings = out.get("strings")
    if not isinstance(strings, Mapping) or "defaults" not in strings:
        return out
    defaults = strings["defaults"]
    if not isinstance(defaults, Mapping):
        raise BundleError("holds keys that are merged under every string", file=files.manifest, key="strings.defaults")
    rest = {name: part for name, part in strings.items() if name != "defaults"}
    out["strings"] = {
        name: merged(defaults, part) if isinstance(part, Mapping) else part for name, part in rest.items()
    }
    return out


def _with_strings(values: dict[str, Any], files: Files) -> dict[str, Any]:
    """Fill in what the materials of its strings give, then the string set that a bundle names."""
    values, name = with_materials(values, file=files.manifest), values.get("strings_from")
    return values if not isinstance(name, str) else with_set(values, name, over=False, file=files.manifest)


@without_collecting
def load_instrument(name_or_path: str | os.PathLike[str], *, allow_code: bool = False) -> Instrument:
    """Load an instrument; `name_or_path`, `allow_code` and errors are those of `Instrument.load`."""
    return Instrument.load(name_or_path, allow_code=allow_code)


__all__ = ["Instrument", "OutputPart", "load_instrument"]
