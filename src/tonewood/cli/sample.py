"""``tonewood sample``: an instrument's notes as a sample library for samplers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    BundleName,
    Json,
    Overrides,
    StringSetName,
    allow,
    load,
    need,
    print_json,
    progress,
)
from tonewood.cli.options import takes_render_options
from tonewood.errors import TonewoodError
from tonewood.sound.render.options import RenderOptions


@takes_render_options(
    without=[
        "max_duration",
        "tail",
        "lead_in",
        "channel_per_string",
        "capo",
        "energy",
        "gain_db",
        "preset",
        "room",
        "room_distance",
        "room_mix_db",
    ]
)
def sample(
    instrument: BundleName,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="NAME.sfz", help="SFZ file; its samples go into a folder NAME")
    ],
    options: RenderOptions,
    velocities: Annotated[
        str, typer.Option(metavar="NUMBERS", help="velocities to render, with commas between them")
    ] = "32,64,96,120",
    every: Annotated[int, typer.Option(help="semitones between sampled keys")] = 3,
    round_robins: Annotated[int, typer.Option(help="strokes of each key and velocity, played in turn")] = 2,
    keys: Annotated[
        str | None, typer.Option("--range", metavar="LOW-HIGH", help="keys, as E2-E5; default: all of the instrument")
    ] = None,
    duration: Annotated[float, typer.Option(help="longest sample, s")] = 8.0,
    releases: Annotated[
        bool, typer.Option("--releases/--no-releases", help="samples of the sound after a key comes up")
    ] = True,
    sound_format: Annotated[str, typer.Option("--format", help="of the samples: flac or wav")] = "flac",
    jobs: Annotated[int, typer.Option(help="renders at a time; -1 for one per core")] = 1,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Render INSTRUMENT to a sample library: NAME.sfz, NAME.dspreset, and a folder NAME of sound files.

    SFZ files are read by sfizz, ARIA, Decent Sampler and others.
    """
    from tonewood.workshop.sampling.library import Sampling, make_library

    if sound_format not in ("flac", "wav"):
        raise TonewoodError(f"is {sound_format!r}; flac or wav are allowed", key="--format")
    if jobs == 0 or jobs < -1:
        raise TonewoodError(f"is {jobs}; 1 or more are allowed, or -1", key="--jobs")
    if jobs != 1:
        need("batch", "joblib")
    allow("--duration", duration, 0.5, 120.0, "s")
    lowest, highest = _range(keys)
    sampling = Sampling(every, _numbers(velocities), round_robins, lowest, highest, duration, releases)
    bundle = load(instrument, settings, allow_code, strings)
    with progress("rendering") as advance:
        library = make_library(bundle, output, sampling, options, jobs=jobs, suffix=f".{sound_format}", tell=advance)
    report = {
        "sfz": str(library.sfz), "decent_sampler": str(library.decent), "folder": str(library.folder),
        "samples": library.n_samples, "releases": library.n_releases, "seconds": library.seconds, "bytes": library.size,
        "gain_db": library.gain_db, "rings": library.rings,
    }  # fmt: skip
    if as_json:
        print_json("sample", report)
        return
    print(
        f"{library.sfz}: {library.n_samples} samples and {library.n_releases} releases, {library.seconds:.0f} s of "
        f"sound, {library.size / 1e6:.1f} MB in {library.folder}"
    )
    print(f"  all at {library.gain_db:+.1f} dB re the instrument's calibrated level; Decent Sampler: {library.decent}")
    if library.rings:
        print("  notes ring on when their keys come up: they have no release")


def _numbers(text: str) -> list[int]:
    words = [word.strip() for word in text.split(",")]
    if not all(word.isascii() and word.isdigit() for word in words):
        raise TonewoodError(
            f"is {text!r}; numbers from 1 to 127 with commas between them are allowed", key="--velocities"
        )
    return [int(word) for word in words]


def _range(text: str | None) -> tuple[int | None, int | None]:
    """Keys of ``E2-E5`` or ``40-76``."""
    from tonewood.instrument.scales import note_number

    if text is None:
        return None, None
    low, dash, high = text.partition("-")
    try:
        numbers = [int(word) if word.isdecimal() else note_number(word) for word in (low.strip(), high.strip())]
    except (TonewoodError, ValueError):
        numbers = []
    if not dash or len(numbers) != 2 or numbers[0] > numbers[1]:
        raise TonewoodError(f"is {text!r}; two keys, the lower one first, are allowed, as E2-E5", key="--range")
    return numbers[0], numbers[1]
