"""References between the parts of a bundle: points, strings, exciters, parameters and sources that must exist."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from tonewood.errors import BundleError, ScoreError
from tonewood.instrument.bundle.keys import check_keys
from tonewood.instrument.bundle.schema import Bundle, ControllerMap, Velocity
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.scales import note_number
from tonewood.support.validation_messages import did_you_mean

#: parameters of an exciter that a note states beside its force
OF_NOTES = ("from_bridge", "angle_deg")


def check_references(
    spec: Bundle,
    points: Collection[str],
    exciters: Mapping[str, Exciter[Any]],
    file: Path,
    open_note: Callable[[str], float],
) -> None:
    """Check that every part which another one names is there, and that what moves a parameter stays in its range.

    spec : all keys.
    points : of the body, where strings may end and exciters push.
    exciters : name -> plugin.
    file : the manifest, for errors.
    open_note : string -> note number of the open string.
    Raises BundleError : one is not, or does not; names the key, and what is allowed.
    """

    def none(kind: str, name: str, names: Iterable[str], key: str) -> BundleError:
        """Error for a name that none of the `known` things of a kind has."""
        words = list(names)
        hint = did_you_mean(name, words)
        reason = f"there is no {kind} {name!r}; {hint}there are {', '.join(words) or 'none'}"
        return BundleError(reason, file=file, key=key)

    def moved(entry: Velocity | ControllerMap, key: str) -> None:
        exciter, _, name = entry.parameter.partition(".")
        if exciter not in exciters:
            raise none("exciter", exciter, exciters, f"{key}.parameter")
        fields = exciters[exciter].Parameters.model_fields
        if name not in fields:
            raise none(f"parameter of {exciter}", name, fields, f"{key}.parameter")
        for end in ("low", "high"):
            try:
                exciters[exciter].adjusted({name: getattr(entry, end)})
            except BundleError as fault:
                raise BundleError(f"{entry.parameter} {fault.reason}", file=file, key=f"{key}.{end}") from None

    for name, part in spec.strings.items():
        for end in part.ends:
            component, _, point = end.partition(".")
            if component != "body" or point not in points:
                raise none("point", end, [f"body.{p}" for p in points], f"strings.{name}.end")
        open_note(name)
    for name, attached in spec.connections.items():
        for string in attached.strings or ():
            if string not in spec.strings:
                raise none("string", string, spec.strings, f"connections.{name}.strings")
    check_keys(spec, file, open_note)
    playing = spec.playing
    if spec.strings:
        moved(playing.velocity, "playing.velocity")
        if playing.velocity.parameter.partition(".")[2] in OF_NOTES:
            reason = (
                "is no force or speed, which volume and human variation scale; `playing.controls` move any parameter"
            )
            raise BundleError(f"{playing.velocity.parameter} {reason}", file=file, key="playing.velocity.parameter")
    for control, entry in playing.controls.items():
        moved(entry, f"playing.controls.{control}")
    if playing.exciter is not None and playing.exciter not in exciters:
        raise none("exciter", playing.exciter, exciters, "playing.exciter")
    switched = [("switches", k, v) for k, v in playing.switches.items()]
    switched += [("noises", k, v) for k, v in playing.noises.named.items()]
    switched += [("slurs", k, v) for k, v in playing.slurs.named.items()]
    for kind, key, target in [*switched, *(("keyswitches", k, v) for k, v in playing.keyswitches.items())]:
        if target not in exciters:
            raise none("exciter", target, exciters, f"playing.{kind}.{key}")
        on_body = exciters[target].at is not None
        if kind in ("noises", "slurs") and on_body != (key in ("key", "release")):
            reason = f"{target!r} acts on strings; an exciter with `at`, a point of the body, is wanted"
            if on_body:
                reason = f"{target!r} acts on {exciters[target].at}; an exciter of strings, without `at`, is wanted"
            raise BundleError(reason, file=file, key=f"playing.{kind}.{key}")
        if kind == "keyswitches":
            try:
                note_number(key)
            except ScoreError as fault:
                raise BundleError(fault.reason, file=file, key=f"playing.{kind}.{key}") from None
    for name, exciter in exciters.items():
        if exciter.at is not None and exciter.at not in {f"body.{p}" for p in points}:
            raise none("point", exciter.at, [f"body.{p}" for p in points], f"exciters.{name}.at")
    for preset, options in spec.presets.items():
        for output in options.outputs or ():
            if output not in (names := [group.name for group in spec.outputs]):
                raise none("output", output, names, f"presets.{preset}.outputs")
    for path, origin in spec.provenance.items():
        if origin.source is not None and origin.source not in spec.sources:
            raise none("source", origin.source, spec.sources, f"provenance.{path}.source")
        if origin.source is None and origin.kind in ("measured", "estimated", "published", "computed"):
            raise BundleError(f"{origin.kind} figures need a source", file=file, key=f"provenance.{path}.source")
