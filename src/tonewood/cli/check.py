"""``tonewood check``: passivity, tuning and provenance of an instrument."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import AllowCode, BundleName, Json, Overrides, StringSetName, load, print_json
from tonewood.cli.options import render_options

if TYPE_CHECKING:
    from tonewood.instrument.inspection.frequencies import MicrophoneResponse, Pitch
    from tonewood.instrument.inspection.mounted import MountedPitch
    from tonewood.instrument.model.assembly import Model

#: share of the tension by which the tuner may change it at a stop; that of no built-in instrument exceeds 0.03
_STOP_TENSION = 0.1
#: cause of partials that are off
_DETUNED = "the plugin's `detuned` gives others than its `basis`"
#: stops whose second plane is off that are printed
_PLANES = 12
#: peak sound of a microphone per N on the bridge, re full scale, from which on its table is doubted
LOUD = 1e3
#: Hz, lowest frequency that is heard
AUDIBLE = 20.0


def check(
    instrument: BundleName,
    fs: Annotated[int, typer.Option(help="sampling rate to assemble it at, Hz")] = 48000,
    strings: StringSetName = None,
    settings: Overrides = None,
    sensitive: Annotated[
        bool, typer.Option("--sensitivity", help="tell how far each mode moves by 0.1 mm of each part and by 1 g")
    ] = False,
    every: Annotated[
        bool, typer.Option("--all", help="print every string, stop, microphone and source, not what matters first")
    ] = False,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> int:
    """Load INSTRUMENT, test its body, microphones and stops: first what is wrong, wolf notes and pitches that are off.

    Every stop is checked twice: its string alone on the body, as it is tuned, and with all other strings open beside
    it; of keys with dampers, with the other strings of its key.

    Exit code 2 if it cannot be played or its body could create energy.
    """
    from tonewood.instrument.bundle.added import added_line
    from tonewood.instrument.inspection.changing import changing_bases
    from tonewood.instrument.inspection.frequencies import (
        PLANE_CENTS,
        TOLERANCE_CENTS,
        check_transfers,
        microphone_responses,
        pitches,
    )
    from tonewood.instrument.inspection.mounted import mounted_pitches
    from tonewood.instrument.inspection.potentials_at_rest import (
        forces_at_rest,
        small_motions,
        touched_at_rest,
    )
    from tonewood.instrument.model.assembly import assemble
    from tonewood.performance.engine.trial import try_parts

    render_options({"fs": fs})
    bundle = load(instrument, settings, allow_code, strings)
    model = assemble(bundle, fs, outputs=tuple(bundle.pickups), alone=True)
    check_transfers(model)
    silent = try_parts(model)
    body = _body(model)
    tones = pitches(model)
    wolves = [p for p in tones if p.wolf is not None]
    off = [p for p in tones if abs(p.error_cents) > TOLERANCE_CENTS]
    off_planes = sorted((p for p in tones if _worst_plane(p) > PLANE_CENTS), key=_worst_plane, reverse=True)
    together = mounted_pitches(model, tones)
    pairs = list(zip(tones, together, strict=True))
    spec = bundle.spec
    report: dict[str, Any] = {
        "instrument": bundle.name,
        "title": spec.title,
        "licence": spec.licence,
        "folder": str(bundle.folder),
        "plugins": list(bundle.plugin_names),
        "fs": fs,
        "n_modes": model.n_modes - sum(_modes_of_other_outputs(model)),
        "n_modes_all_outputs": model.n_modes,
        "body": body,
        "model": [line for line in model.warnings if line != f"body: {body.get('repair')}"],
        "added": [added_line(entry) for entry in spec.body.added],
        "strings": {name: _string(model, name, pairs) for name in model.groups},
        "microphones": [_microphone(response) for response in microphone_responses(model)],
        "silent_outputs": silent,
        "potentials": [asdict(motion) | {"doubt": motion.doubt} for motion in small_motions(model)],
        "forces_at_rest": forces_at_rest(model),
        "touched_at_rest": touched_at_rest(model),
        "changing_bases": changing_bases(model),
        "off_pitch": [pitch_row(p) for p in off],
        "off_pitch_mounted": [_mounted_row(p, m) for p, m in pairs if abs(m.error_cents) > TOLERANCE_CENTS],
        "off_planes": [plane_row(p) for p in off_planes],
        "wolf_notes": [pitch_row(p) for p in wolves],
        "table_doubts": bundle.origins.table_doubts(),
        "stand_ins": [{"path": path, "note": spec.provenance[path].note} for path in bundle.origins.stand_ins()],
        "unknown": bundle.origins.of_unknown_origin(),
        "provenance": dict(Counter(entry.kind for entry in spec.provenance.values())),
        "sources_used": sorted({entry.source for entry in spec.provenance.values() if entry.source}),
        "sources": {key: source.model_dump(exclude_none=True) for key, source in spec.sources.items()},
    }
    ok, moves = bool(body["passive"]), []
    if sensitive:
        from tonewood.workshop.design.sensitivity import sensitivity, words

        sensed = sensitivity(bundle)
        moves = words(sensed)
        rows = {name: cents.tolist() for name, cents in sensed.rows.items()}
        report["sensitivity"] = {"modes": list(sensed.labels), "freq": sensed.freq.tolist(), "cents": rows}
    if as_json:
        print_json("check", report, ok=ok)
    else:
        _print(report, ok, every, moves)
    return 0 if ok else 2


def _modes_of_other_outputs(model: Model) -> list[int]:
    """Modes of each bank that only other outputs than the default one hear."""
    system = model.system
    if not model.outputs:
        return []
    heard = {probe.component for i in model.outputs[0].readouts for probe in system.readouts[i].probes}
    others = {drive.component for drive in system.drives} - heard
    return [system.compiled[system.slot(name)].basis.n_modes for name in sorted(others)]


def _body(model: Model) -> dict[str, Any]:
    """The body's modes and whether it is passive; real modes are by construction."""
    from tonewood.physics.passivity.basis import check_basis

    basis = model.system.compiled[model.system.slot("body")].basis
    verdict = check_basis(basis, [name for name, p in model.body_points.items() if p.driven], dt=model.system.dt)
    summary, passive = verdict.summary(), verdict.passive
    if passive and basis.is_real:
        summary = "passive by construction (real modes)"
    freq = basis.natural_freq
    return {
        "n_modes": basis.n_modes,
        "freq_lower": float(freq.min(initial=math.inf)) if freq.size else None,
        "freq_upper": float(freq.max(initial=0.0)) if freq.size else None,
        "n_overdamped": int((basis.damping_ratio >= 1.0).sum()),
        "passive": passive,
        "summary": summary,
        **{key: str(value) for key, value in basis.metadata.items() if key == "repair"},
    }


def _microphone(response: MicrophoneResponse) -> dict[str, Any]:
    """A microphone's strongest response to a string, and the fault of its table, if any."""
    doubt = None
    if response.peak == 0.0:
        doubt = "hears nothing of the strings: its table has no residues below the highest mode that is stepped"
    elif response.peak > LOUD * response.full_scale:
        doubt = (
            f"gives {response.peak / response.full_scale:.0e} times full scale per N: check the table's unit and "
            "`full_scale`"
        )
    return {
        "output": response.output,
        "channel": response.channel,
        "unit": response.unit,
        "n_modes": response.n_modes,
        "peak": response.peak,
        "peak_freq": response.freq if response.peak else None,
        "doubt": doubt,
    }


def _string(model: Model, name: str, pairs: list[tuple[Pitch, MountedPitch]]) -> dict[str, Any]:
    from tonewood.instrument.inspection.frequencies import feel
    from tonewood.instrument.inspection.string_laws import law_errors
    from tonewood.instrument.scales import note_name

    string, mine = model.strings[name], [(p, m) for p, m in pairs if p.string == name]
    tension, errors = string.tuning.given, law_errors(model, name)
    return {
        "note": note_name(string.open_note),
        "stops": string.n_stops,
        "n_modes": sum(model.system.compiled[model.system.slot(c)].basis.n_modes for c in string.components),
        "tension": mine[0][0].tension,
        "stop_tension": _stop_tension([p for p, _ in mine]),
        "count": len(string.group),
        "feel": asdict(feel(model, name)),
        "given_tension": tension.given,
        "held": tension.held,
        "held_note": tension.line() if tension.noticeable else None,
        "worst_cents": max((p.error_cents for p, _ in mine), key=abs),
        "worst_cents_mounted": max((m.error_cents for _, m in mine), key=abs),
        "loss_error": None
        if not errors or errors[0].decay is None
        else {"partial": errors[0].decay_partial, "relative": errors[0].decay},
        "law": [asdict(e) | {"decay_is_off": e.decay_is_off, "pitch_is_off": e.pitch_is_off} for e in errors],
    }


def _stop_tension(mine: list[Pitch]) -> dict[str, float]:
    """Stop at which the tuner has changed the tension most, and by which share of the open string's."""
    worst = max(mine, key=lambda p: abs(p.tension / mine[0].tension - 1))
    return {"stop": worst.stop, "relative": worst.tension / mine[0].tension - 1}


def _worst_plane(p: Pitch) -> float:
    """Cents by which one of a string's further planes is off; 0 without any."""
    return max((abs(plane.off_cents) for plane in p.planes[1:]), default=0.0)


def plane_row(p: Pitch) -> dict[str, Any]:
    """A stop and its planes as plain values."""
    from tonewood.instrument.scales import note_name

    planes = {x.component: {"cents": x.cents, "split_cents": x.split_cents, "share": x.share} for x in p.planes}
    row: dict[str, Any] = {"string": p.string, "stop": p.stop, "note": note_name(p.note)}
    return row | {"off_cents": _worst_plane(p), "planes": planes}


def plane_words(row: dict[str, Any]) -> str:
    """Cents of each plane from the note, in a few words."""
    first, *others = [(name.rpartition(".")[2], plane) for name, plane in row["planes"].items()]
    second = ", ".join(f"{name} {plane['cents']:+.1f} (split {plane['split_cents']:+.1f})" for name, plane in others)
    return f"{first[0]} {first[1]['cents']:+.1f}, {second} cents"


def _mounted_row(p: Pitch, mounted: MountedPitch) -> dict[str, Any]:
    """A stop that is off its pitch when all strings are on the body."""
    from tonewood.instrument.scales import note_name

    return {
        "string": p.string,
        "stop": p.stop,
        "note": note_name(p.note),
        "wanted_freq": p.wanted_freq,
        "cents_alone": p.error_cents,
        "cents_mounted": mounted.error_cents,
        "modes": [{"cents": cents, "share": share} for cents, share in mounted.modes],
        "partner": mounted.partner,
        "partner_share": mounted.partner_share,
    }


def pitch_row(p: Pitch) -> dict[str, Any]:
    """A pitch as plain values."""
    from tonewood.instrument.scales import note_name
    from tonewood.support.units import cents

    row: dict[str, Any] = {
        "string": p.string,
        "stop": p.stop,
        "note": note_name(p.note),
        "wanted_freq": p.wanted_freq,
        "freq": p.freq,
        "error_cents": p.error_cents,
        "t60": p.t60,
    }
    if p.wolf is not None:
        row["wolf"] = {
            "freq": p.wolf.freq,
            "cents": cents(p.wolf.freq / p.freq),
            "level_db": p.wolf.level_db(p.modes[0]),
        }
    return row


def wolf_line(row: dict[str, Any]) -> str:
    """One line about a wolf note."""
    wolf = row["wolf"]
    missed = f", {row['error_cents']:+.1f} cents off" if abs(row["error_cents"]) > 1 else ""
    return (
        f"{row['string']} stop {row['stop']:>2} ({row['note']}, {row['freq']:.1f} Hz{missed}): a body mode at "
        f"{wolf['freq']:.1f} Hz, {wolf['cents']:+.0f} cents and {wolf['level_db']:+.1f} dB from it"
    )


def _mounted_line(row: dict[str, Any]) -> str:
    """One line about a stop whose partial is shared."""
    modes = " and ".join(f"{mode['cents']:+.1f}" for mode in row["modes"])
    shared = "" if row["partner"] is None else f", shared with {row['partner']} ({100 * row['partner_share']:.0f} %)"
    return (
        f"{row['string']} stop {row['stop']:>2} ({row['note']}): {modes} cents, {row['cents_alone']:+.1f} alone{shared}"
    )


def _law_lines(rows: list[dict[str, Any]]) -> list[str]:
    """How well a string's partials keep to its own law on a rigid end: one line, then warnings."""
    if not rows:
        return ["does not end on the body: its partials are compared with no law"]
    worst = max(abs(row["cents"]) for row in rows if not row["bend_cents"])
    bent = next((row for row in rows if row["bend_cents"]), None)
    if rows[0]["decay"] is None:
        decays = "its plugin does not tell its loss law (`decay_rate`): decays are not compared"
    else:
        decay = max(abs(row["decay"]) for row in rows if not row["bend_cents"])
        shown = f" ({100 * abs(bent['decay']):.2g} %)" if bent else ""
        decays = f"decays within {100 * decay:.2g} %{shown} of its loss law"
    shown = f" ({abs(bent['cents']):.1g} bent by {bent['bend_cents']:g})" if bent else ""
    out = [f"partials within {worst:.1g} cents{shown}, {decays}"]
    # of each kind the first: at a stop before bent
    if row := next((row for row in rows if row["decay_is_off"]), None):
        steep = "the law grows too steeply without loss to the air or of stretching"
        why = steep if abs(row["own"]) > 0.5 * abs(row["decay"]) else _DETUNED
        rate = f"{1 + row['decay']:.4g} times the rate of its loss law on a rigid end"
        out.append(f"warning: partial {row['decay_partial']} {_held(row)} decays at {rate}: {why}")
    if row := next((row for row in rows if row["pitch_is_off"]), None):
        beside = f"{row['cents']:+.3g} cents from that of a basis made for this tension"
        out.append(f"warning: partial {row['pitch_partial']} {_held(row)} is {beside}: {_DETUNED}")
    return out


def _held(row: dict[str, Any]) -> str:
    bend = f", bent by {row['bend_cents']:g} cents," if row["bend_cents"] else ""
    return f"at stop {row['stop']}{bend}"


def _listed(label: str, lines: list[str], most: int | None) -> None:
    """Print lines behind a label, and how many more there are."""
    for line in lines[:most]:
        print(f"  {label}: {line}")
    if most is not None and (more := len(lines) - most) > 0:
        print(f"  {label}: {more} more (--all)")


def _print(report: dict[str, Any], ok: bool, every: bool, moves: list[str]) -> None:
    """What is wrong first, then notes that are off, then the body; each string, microphone and source on request."""
    from tonewood.instrument.inspection.potentials_at_rest import touched_lines

    most = None if every else 4
    warnings = _warnings(report)
    print(f"{report['instrument']}: {report['title']} ({report['licence']})")
    print(f"  folder: {report['folder']}")
    _listed("warning", warnings, None)
    _listed("off pitch", [
        f"{row['string']} stop {row['stop']} ({row['note']}): {row['error_cents']:+.1f} cents"
        for row in sorted(report["off_pitch"], key=lambda row: -abs(row["error_cents"]))
    ], most)  # fmt: skip
    worst = sorted(report["wolf_notes"], key=lambda row: abs(row["wolf"]["level_db"]))
    _listed("wolf note", [wolf_line(row) for row in (report["wolf_notes"] if every else worst)], most)
    shared = sorted(report["off_pitch_mounted"], key=lambda row: -abs(row["cents_mounted"]))
    _listed("left out", touched_lines(report["touched_at_rest"]), None)
    _listed("with all strings on", [_mounted_line(row) for row in shared], most)
    planes = [
        f"{row['string']} stop {row['stop']:>2} ({row['note']}): {plane_words(row)}" for row in report["off_planes"]
    ]
    _listed("second plane", planes, _PLANES if every else most)
    _print_body(report)
    if every:
        _print_strings(report)
        _print_microphones(report)
    else:
        _print_strings_briefly(report)
    _print_origins(report, every)
    for line in moves:
        print(f"  {line}")
    warned = f", with {len(warnings)} warning{'s' * (len(warnings) > 1)}" if warnings else ""
    if not every:
        print("  (--all prints every string, stop, microphone and source)")
    print(f"ok{warned}" if ok else "not ok: its body could create energy")


def _warnings(report: dict[str, Any]) -> list[str]:
    """Silent parts, tables that may be others, microphones that hear nothing, strings that miss their law."""
    doubts = [*report["model"], *report["table_doubts"]]
    doubts += [f"{row['output']}.{row['channel']} {row['doubt']}" for row in report["microphones"] if row["doubt"]]
    doubted = {row["output"] for row in report["microphones"] if row["doubt"]}
    doubts += [
        f"output {name} is silent whatever is played: its place does not move, or nothing moves the body"
        for name in report["silent_outputs"]
        if name not in doubted
    ]
    if report["body"]["n_modes"] > 1 and report["body"]["freq_upper"] < AUDIBLE:  # one alone may hold a gong
        doubts.append(f"body: no mode above {AUDIBLE:g} Hz: check the unit of its frequencies")
    if 2 * report["body"]["n_overdamped"] > report["body"]["n_modes"]:
        doubts.append(f"body: {report['body']['n_overdamped']} modes do not oscillate: check their Q, or zeta")
    doubts += [row["doubt"] for row in report["potentials"] if row["doubt"]]
    doubts += [
        f"connection {name}: pushes with {abs(force):.3g} N at rest, which sounds at the start of every render: the "
        "`offset` of a contact should be 0 or less"
        for name, force in report["forces_at_rest"].items()
    ]
    doubts += [
        f"{'body' if name == 'body' else f'string {name}'}: its plugin's `basis` gives other modes when it is called "
        "again: two renders may differ, and the figures here hold for one call"
        for name in report["changing_bases"]
    ]
    for name, row in report["strings"].items():
        if abs(share := row["stop_tension"]["relative"]) > _STOP_TENSION:
            doubts.append(
                f"string {name}: stop {row['stop_tension']['stop']:g} is in tune at {100 * share:+.0f} % of the open "
                "string's tension more or less: its plugin's `basis` at this stop is out of tune, or a mode of the "
                "body pulls it"
            )
        lines = [line for line in _law_lines(row["law"]) if line.startswith("warning: ")]
        doubts += [f"string {name}: {line.removeprefix('warning: ')}" for line in lines]
    return doubts


def _print_body(report: dict[str, Any]) -> None:
    body = report["body"]
    more = "" if (total := report["n_modes_all_outputs"]) == report["n_modes"] else f" ({total} with all outputs)"
    print(f"  {report['n_modes']} modes{more} at {report['fs']} Hz, plugins {', '.join(report['plugins'])}")
    if body["n_modes"]:
        span = f", {body['freq_lower']:.0f} to {body['freq_upper']:.0f} Hz"
        print(f"  body: {body['n_modes']} modes{span}: {body['summary']}")
    if "repair" in body:
        print(f"  body: {body['repair']}")
    for line in report["added"]:
        print(f"  added to the body: {line}: passive by construction")
    for row in report["potentials"]:
        if not row["effect"]:
            print(f"  potential {row['name']}: no effect leaves it out, `--effects none` neither")


def _print_strings_briefly(report: dict[str, Any]) -> None:
    """All strings in a line, and those whose pitch or tension is held against the bundle's figure."""
    rows = report["strings"]
    if rows:
        alone, all_on = (max(abs(row[key]) for row in rows.values()) for key in ("worst_cents", "worst_cents_mounted"))
        print(f"  {len(rows)} strings, every stop within {alone:.2g} cents alone, {all_on:.2g} with all on")
    for name, row in rows.items():
        if row["held_note"]:
            print(f"  string {name}: {row['held_note']}")
    _print_tension(report)


def _print_tension(report: dict[str, Any]) -> None:
    rows = report["strings"].values()
    forces = [f and row["count"] * f for row in rows for f in [row["feel"]["force_on_bridge"]]]
    down = "" if None in forces else f", {sum(forces):.0f} N down on the bridge"
    tension = sum(row["count"] * row["tension"] for row in rows)
    print(f"  all strings: {tension:.0f} N along{down}" if rows else "  a body alone, without strings")


def _print_strings(report: dict[str, Any]) -> None:
    """Each string: its modes, tension, pitch, feel and law."""
    for name, row in report["strings"].items():
        stops = f"{row['stops']} stops" if row["stops"] else "open"
        several = f", one of {row['count']} of its key" if row["count"] > 1 else ""
        print(
            f"  string {name}{several}: {row['note']}, {stops}, {row['n_modes']} modes, {row['tension']:.2f} N, "
            f"within {abs(row['worst_cents']):.2g} cents alone, {abs(row['worst_cents_mounted']):.2g} with all on"
        )
        feel = row["feel"]
        if feel["newton_per_mm"] is not None:
            down = ""
            if feel["break_angle_deg"] is not None:
                down = f"; {feel['break_angle_deg']:g} deg over it, {feel['force_on_bridge']:.1f} N down on it"
            distance = 1e3 * feel["from_bridge"]
            print(f"    {feel['newton_per_mm']:.2f} N for 1 mm sideways, {distance:.0f} mm from the bridge{down}")
        for line in [row["held_note"], *(x for x in _law_lines(row["law"]) if not x.startswith("warning"))]:
            if line:
                print(f"    {line}")
    _print_tension(report)


def _print_microphones(report: dict[str, Any]) -> None:
    for row in report["microphones"]:
        if row["peak"]:
            peak = f"at most {row['peak']:.3g} {row['unit']}/N, at {row['peak_freq']:.0f} Hz"
            print(f"  microphone {row['output']}.{row['channel']}: {row['n_modes']} modes in its bank, {peak}")


def _print_origins(report: dict[str, Any], every: bool) -> None:
    """Stand-ins, figures of unknown origin, and on request sources."""
    stand_ins = [row["path"] + (f": {row['note']}" if row["note"] else "") for row in report["stand_ins"]]
    _listed("stand-in", stand_ins, None if every else 2)
    if report["unknown"]:
        print(f"  of unknown origin: {', '.join(report['unknown'])}")
    if not every:
        return
    kinds = ", ".join(f"{count} {kind}" for kind, count in report["provenance"].items())
    print(f"  figures: {kinds or 'of unknown kind'}")
    for key, source in report["sources"].items():
        address = source.get("doi") or source.get("url") or ""
        unused = "" if key in report["sources_used"] else ", which no figure names"
        print(f"  source {key}{unused}: {source['text']}{', ' + address if address else ''} ({source['licence']})")
