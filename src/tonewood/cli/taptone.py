"""``tonewood taptone``: frequency and Q of the modes that ring after taps."""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.commands import InterruptError
from tonewood.cli.common import Json, allow, allow_band, allow_file, need, print_json, warn
from tonewood.errors import OutputError, TonewoodError
from tonewood.support.plotting import PICTURES

if TYPE_CHECKING:
    from tonewood.workshop.taps.cutting import Taps
    from tonewood.workshop.taps.ringing import Peak

#: Hz, of a recording
_RATE = 48000


def taptone(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILES", help="recordings of taps (.wav, .flac), one tap or many in each"),
    ] = None,
    record: Annotated[
        int | None,
        typer.Option(metavar="TAPS", help="record so many taps from the microphone, into the one FILE (.wav)"),
    ] = None,
    device: Annotated[str | None, typer.Option(help="microphone, by name or number; the default otherwise")] = None,
    fs: Annotated[int | None, typer.Option(help="sampling rate of --record, Hz; 48000 if left out")] = None,
    channel: Annotated[int, typer.Option(help="channel of the files that is used, from 1")] = 1,
    band: Annotated[tuple[float, float], typer.Option(metavar="LOW HIGH", help="Hz, band of the peaks")] = (
        50.0,
        1000.0,
    ),
    names: Annotated[
        bool, typer.Option(help="name A0, T1 and T2 of a body with a soundhole; not for a bare plate")
    ] = True,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="write the peaks to this table (.csv)")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="draw spectrum and peaks into this picture (.png, .pdf, .svg)")
    ] = None,
    as_json: Json = False,
) -> None:
    """List what rings after taps: frequency, Q, their intervals of 90 %, and how many taps show it.

    The force of a tap is not known: levels are relative, and there is no mobility.
    """
    from tonewood.support.whole_files import write_whole
    from tonewood.workshop.taps.names import named
    from tonewood.workshop.taps.recordings import read_taps
    from tonewood.workshop.taps.ringing import ringing

    paths = _check(files or [], record, fs, device, channel, band, output, plot)
    if record is not None:
        _record(paths[0], record, fs or _RATE, device)
    taps = read_taps(paths, channel)
    used = taps.analysed()
    peaks = ringing(used, taps.fs, band)
    called = {peak: name for name, peak in named(peaks).items()} if names else {}
    rows = [_row(peak, called.get(peak)) for peak in peaks]
    warnings = list(taps.left_out) + _doubts(taps)
    if output is not None:
        write_whole(output, _csv(rows))
    if plot is not None:
        from tonewood.workshop.taps.figure import draw_taps

        draw_taps(used, taps.fs, band, peaks, called, plot)
    if as_json:
        report: dict[str, Any] = {
            "files": [str(path) for path in paths], "taps": len(used), "left_out": list(taps.left_out),
            "ring_out_s": taps.ring_out, "analysed_s": len(used[0]) / taps.fs, "band_Hz": list(band), "peaks": rows,
            "quantity": "relative level; no force was measured, so no mobility", "warnings": warnings,
        }  # fmt: skip
        print_json("taptone", report)
        return
    warn(warnings)
    print(f"{len(used)} taps, silent after {taps.ring_out:.2f} s; {len(used[0]) / taps.fs:.2f} s of each analysed")
    print("      f/Hz      90 %           Q       90 %        level/dB   taps")
    for peak in peaks:
        name = called.get(peak, "") + ("" if peak.certain else " uncertain")
        (f_low, f_high), (q_low, q_high) = peak.freq_90, peak.quality_90
        print(
            f"{peak.freq:>10.2f}  {f_low:>7.2f} {f_high:<8.2f} {peak.quality:>6.1f}  {q_low:>5.1f} {q_high:<6.1f} "
            f"{peak.level:>8.1f}   {peak.seen:>3}/{peak.taps:<3} {name}".rstrip()
        )
    if called:
        print("names by order, ratio and level alone: cover the hole and tap again, A0 has to go")
    print("levels are relative: the force was not measured, so there is no mobility")
    for path in (output, plot):
        if path is not None:
            print(f"written: {path}")


def _check(
    files: list[Path],
    record: int | None,
    fs: int | None,
    device: str | None,
    channel: int,
    band: tuple[float, float],
    output: Path | None,
    plot: Path | None,
) -> list[Path]:
    if record is None and not files:
        raise TonewoodError(
            "no file was given; recordings of taps, or --record TAPS FILE.wav, are allowed", key="FILES"
        )
    for option, value in (("--fs", fs), ("--device", device)):
        if record is None and value is not None:
            raise TonewoodError("is for --record, which is not given", key=option)
    if record is not None:
        allow("--record", record, 1, 100, "taps")
        allow("--fs", fs or _RATE, 8000, 192_000, "Hz")
        if len(files) != 1:
            raise TonewoodError("--record writes one file; a name ending in .wav is allowed", key="FILES")
        allow_file("FILES", files[0], ".wav")
        if files[0].exists():
            raise TonewoodError("is there already; it would be overwritten", file=files[0], key="--record")
    allow("--channel", channel, 1, 256, "")
    allow_band(band)
    allow_file("--output", output, ".csv")
    allow_file("--plot", plot, *PICTURES)
    if plot is not None:
        need("plot", "matplotlib")
    return files


def _record(path: Path, count: int, fs: int, device: str | None) -> None:
    """Record taps and write them into a file."""
    import soundfile as sf

    from tonewood.support.whole_files import AtomicFile
    from tonewood.workshop.taps.recordings import record_taps

    def tell(heard: int) -> None:
        print(f"{heard} of {count} taps", file=sys.stderr, flush=True)

    number = int(device) if device is not None and device.isdecimal() else device
    print(f"wait a second, then tap {count} times and let each ring out", file=sys.stderr, flush=True)
    try:
        samples = record_taps(count, fs=fs, device=number, tell=tell)
    except KeyboardInterrupt:
        raise InterruptError from None
    file = AtomicFile(path)
    try:
        sf.write(str(file.path), samples, fs, subtype="FLOAT", format="WAV")
        file.complete()
    except (OSError, sf.LibsndfileError) as fault:
        raise OutputError(f"cannot be written: {fault}", file=path) from None
    finally:
        file.discard()


def _row(peak: Peak, name: str | None) -> dict[str, Any]:
    return {
        "freq_Hz": peak.freq, "freq_90_Hz": list(peak.freq_90), "Q": peak.quality, "Q_90": list(peak.quality_90),
        "level_dB": peak.level, "seen_in_taps": peak.seen, "taps": peak.taps, "certain": peak.certain, "name": name,
    }  # fmt: skip


def _doubts(taps: Taps) -> list[str]:
    out = []
    if len(taps.samples) < 3:
        out.append(f"{len(taps.samples)} tap(s): three or more at one place tell what repeats")
    return out


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([
        "freq_Hz", "freq_low_Hz", "freq_high_Hz", "Q", "Q_low", "Q_high", "level_dB", "seen_in_taps", "taps", "certain",
        "name",
    ])  # fmt: skip
    for row in rows:
        f, q = row["freq_90_Hz"], row["Q_90"]
        writer.writerow([
            row["freq_Hz"], *f, row["Q"], *q, row["level_dB"], row["seen_in_taps"], row["taps"], int(row["certain"]),
            row["name"] or "",
        ])  # fmt: skip
    return text.getvalue()
