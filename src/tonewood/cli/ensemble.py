"""``tonewood render`` with parts, an ensemble or no instrument: the parts of a score on several instruments, mixed."""

from __future__ import annotations

import re
import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from tonewood.cli.common import dropped_notes_listed, print_json, progress, warn, warn_of_dropped, warn_of_kinds
from tonewood.cli.stems import stem_files, stem_folder
from tonewood.support.units import counted, decibel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tonewood.sound.ensemble.mix import EnsemblePart
    from tonewood.sound.render.level import LevelName
    from tonewood.sound.render.options import RenderOptions


def render_parts(
    score: Path,
    parts: Sequence[EnsemblePart],
    output: Path,
    options: RenderOptions,
    *,
    reading: Mapping[str, Any],
    subtype: str,
    level: LevelName,
    target: float,
    stems: Path | None,
    as_json: bool,
    left_out: list[str] | None,
) -> None:
    """Render and mix; the mix is brought to its level by its true peak.

    `left_out` are lines on parts without an instrument, where the programs of the score chose them, else None.
    """
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.performance.score.reading import read_score
    from tonewood.sound.ensemble.mix import render_ensemble
    from tonewood.sound.files.audio import Audio
    from tonewood.sound.files.tags import Tags
    from tonewood.sound.level.loudness import loudness, matching_gain_db, true_peak
    from tonewood.sound.render.level import LOUDNESS
    from tonewood.sound.render.renderer import SILENT

    began = time.perf_counter()
    lines = list(left_out or ())
    names = [f"{part.part:02d}_" + re.sub(r"\W+", "_", Path(part.instrument).name) for part in parts]
    planned = [] if stems is None else stem_files(stems, names, output)
    with progress("rendering", len(parts)) as advance:
        done = [0]

        def one_more(_: str) -> None:
            done[0] += 1
            advance(done[0])

        with dropped_notes_listed():
            rendered = render_ensemble(
                score, parts, options=options, progress=one_more, reading=dict(reading),
                silent=None if left_out is None else lambda _, why: lines.append(f"{why}, left out"),
            )  # fmt: skip
    fs = options.fs
    mix = np.sum([stem.samples for stem in rendered], axis=0)
    peak = true_peak(mix)
    gain = 0.0
    if level != "calibrated" and peak > 0:
        gain = target - decibel(peak)
        if level == "LUFS":
            gain = min(gain, matching_gain_db(mix, fs, LOUDNESS))
    factor = 10 ** (gain / 20)
    silent = peak <= SILENT
    players = [Instrument.load(stem.part.instrument) for stem in rendered]
    music = read_score(score, **reading)
    clipped = Audio(mix * factor, fs, ("left", "right"), tags=Tags.of(music, players)).save(output, subtype)
    files: list[Path] = []
    if stems is not None:
        sounding = {id(stem.part) for stem in rendered}
        files = [file for part, file in zip(parts, planned, strict=True) if id(part) in sounding]
        with stem_folder(stems, parents=True):
            for stem, file, player in zip(rendered, files, players, strict=True):
                tags = Tags.of(music, [player])
                Audio(stem.samples * factor, fs, ("left", "right"), tags=tags).save(file, subtype)
    lufs = loudness(mix * factor, fs)[0] if find_spec("pyloudnorm") else None
    if lufs is not None and not np.isfinite(lufs):
        lufs = None
    said = {
        "output": str(output), "fs": fs, "frames": len(mix), "duration_s": len(mix) / fs, "level": level,
        "gain_db": gain, "true_peak_dbtp": decibel(peak) + gain if peak > 0 else None, "loudness_lufs": lufs,
        "clipped": clipped, "left_out": lines,
        "render_s": time.perf_counter() - began, "stems": [str(file) for file in files],
        "parts": [
            {
                **stem.part.model_dump(), "notes": stem.summary.notes, "midi_ignored": dict(stem.summary.ignored),
                "notes_dropped": [
                    {"time_s": d.time, "note": d.note, "channel": d.channel, "reason": d.reason}
                    for d in stem.summary.notes_dropped
                ],
                "warnings": list(stem.summary.warnings), "peak_dbfs": decibel(float(np.abs(stem.samples).max())) + gain
                if stem.samples.any() else None,
            }
            for stem in rendered
        ],
    }  # fmt: skip
    if as_json:
        print_json("render-parts", said, ok=not silent)
        if silent:
            raise typer.Exit(1)
        return
    warn(lines)
    for stem in rendered:
        where = f"part {stem.part.part}: "
        warn_of_kinds([where + line for line in stem.summary.warnings])
        warn_of_dropped(stem.summary.notes_dropped, where)
    if clipped:
        warn([f"{counted(clipped, 'sample')} clipped; lower --gain, or use --level peak"])
    peak_text = f"true peak {decibel(peak) + gain:.1f} dBTP" if peak > 0 else "silent"
    loud = f", {lufs:.1f} LUFS" if lufs is not None else ""
    print(f"{output}: {len(mix) / fs:.2f} s, {counted(len(rendered), 'part')} at {fs} Hz, {peak_text}{loud}")
    print(f"  level {level}: gain {gain:+.1f} dB")
    for stem in rendered:
        s, p = stem.summary, stem.part
        ignored = "; without effect: " + ", ".join(f"{n} {kind}" for kind, n in s.ignored.items()) if s.ignored else ""
        print(
            f"  part {p.part} on {p.instrument}, {p.gain_db:+.1f} dB, pan {p.pan:+.2f}: {counted(s.notes, 'note')}, "
            f"{len(s.notes_dropped)} dropped{ignored}"
        )
    for file in files:
        print(f"  {file}")
    if silent:
        raise typer.Exit(1)
