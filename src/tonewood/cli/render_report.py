"""What ``tonewood render`` says of a finished render: lines, or JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tonewood.cli.common import warn_of_dropped, warn_of_kinds
from tonewood.sound.render.renderer import SILENT
from tonewood.support.units import counted, decibel

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from tonewood.performance.effects.base import EffectReport
    from tonewood.sound.level.limiter import Limiter
    from tonewood.sound.live.take import Replay
    from tonewood.sound.render.level import LevelName
    from tonewood.sound.render.renderer import Renderer, Summary

#: smallest step of integers in a file
_STEPS = {"PCM_16": 2.0**-15, "PCM_24": 2.0**-23, "PCM_32": 2.0**-31}
#: strings that are named one by one; least share of the computing time that is reported
_NAMED, _LEAST_SHARE = 2, 0.02


@dataclass(frozen=True, eq=False)
class WrittenSound:
    """A sound file and the render that made it.

    output, subtype : the file, and its format of samples.
    clipped, peak : samples beyond full scale, and the largest one, of the file.
    level, gain_db : its level, and the gain of that.
    limiter : through which it went.
    load_s : s, of reading the score and making the instrument's model.
    stems, stems_clipped : files beside it, and how many samples of each lie beyond full scale, where any do.
    """

    renderer: Renderer | Replay
    output: Path
    subtype: str
    clipped: int
    peak: float
    level: LevelName
    gain_db: float
    limiter: Limiter | None
    load_s: float = 0.0
    stems: Sequence[Path] = ()
    stems_clipped: Mapping[Path, int] = field(default_factory=dict)

    @property
    def silent(self) -> bool:
        """Whether nothing would be heard."""
        return self.renderer.summary().peak_dbfs <= decibel(SILENT) or self.peak < 0.5 * _STEPS.get(
            self.subtype.upper(), 0.0
        )

    def warnings(self) -> list[str]:
        """One line each: of the render, and of the samples of the file."""
        summary = self.renderer.summary()
        lines = list(summary.warnings)
        fate = "beyond full scale" if self.subtype.upper() in ("FLOAT", "DOUBLE") else "clipped"
        if self.clipped:
            were = "sample was" if self.clipped == 1 else "samples were"
            lines.append(f"{self.clipped} {were} {fate}; lower --gain, or use --level peak or --limiter")
        for file, clipped in self.stems_clipped.items():
            were = "sample was" if clipped == 1 else "samples were"
            lines.append(f"{file}: {clipped} {were} {fate}; lower --gain or --normalize, or use --subtype FLOAT")
        if self.limiter is not None and self.limiter.reduction_db > 0:
            lines.append(f"the limiter took away up to {self.limiter.reduction_db:.1f} dB")
        if self.silent and summary.peak_dbfs > decibel(SILENT):
            lines.append(
                f"{self.output} is silent: its peak of {decibel(self.peak):.0f} dBFS is below its smallest step"
            )
        return lines


def print_summary(rendered: WrittenSound, energy: Sequence[Path]) -> None:
    """Print what was rendered, with warnings first."""
    from tonewood.sound.render.level import meaning

    renderer = rendered.renderer
    summary, account = renderer.summary(), renderer.energy
    notes = f"{counted(summary.notes, 'note')}, {len(summary.notes_dropped)} dropped"
    warn_of_kinds(rendered.warnings())
    warn_of_dropped(summary.notes_dropped)
    print(
        f"{rendered.output}: {summary.duration_s:.2f} s, {counted(len(renderer.channels), 'channel')} "
        f"at {summary.fs} Hz, peak {decibel(rendered.peak):.1f} dBFS; {notes}; "
        f"{summary.realtime_factor:.1f} x real time; ended: {summary.end}"
    )
    print(f"  level {rendered.level}: {meaning(renderer.model.outputs, rendered.gain_db)}")
    if summary.room is not None:
        print(f"  room {summary.room}")
    if summary.ignored:
        print(f"  without effect: {', '.join(f'{n} {kind}' for kind, n in summary.ignored.items())}")
    for tension in summary.tensions:
        print(f"  {tension.line()}")
    if summary.zero_frame:
        print(f"  score time 0 is frame {summary.zero_frame}")
    if summary.onset_step_dbfs is not None:
        step = f"{summary.onset_step_dbfs:.0f} dBFS"
        print(f"  a step of {step} at the first frame was smoothed: sound before it was cut off (see --lead-in)")
    for line in left_out_lines(summary):
        print(line)
    for file in rendered.stems:
        print(f"  {file}")
    if account is not None:
        print(
            f"  energy: peak {account.peak:.3g} J, balance open by {account.worst_residual:.1e} of it in an interval, "
            f"{account.worst_cumulative_residual:.1e} summed up: {', '.join(str(path) for path in energy)}"
        )


def left_out_lines(summary: Summary) -> list[str]:
    """One line per effect that was left out for some time with a bound that is not 0; ``--json`` has all effects."""
    lines = []
    by_title: dict[str, list[EffectReport]] = {}
    for report in summary.effects:
        if report.bound is not None and report.bound != 0.0 and report.seconds_active < summary.duration_s:
            by_title.setdefault(report.title, []).append(report)
    for title, reports in by_title.items():
        seconds = [summary.duration_s - report.seconds_active for report in reports]
        if len(reports) <= _NAMED:
            where = " and ".join(f"{r.component} for {s:.2g} s" for r, s in zip(reports, seconds, strict=True))
        else:
            where = f"{len(reports)} strings for {min(seconds):.2g} to {max(seconds):.2g} s"
        bounds = [f"{max(values):.2g} {unit}" for values, unit in _bounds(reports)]
        lines.append(f"  Left out: {title} of {where}, at most {' and '.join(bounds)}.")
    saved = sum(report.seconds_saved for reports in by_title.values() for report in reports)
    whole = saved + summary.render_s
    if lines and saved >= _LEAST_SHARE * whole:
        lines[-1] += f" Saved {saved:.1f} s of {whole:.1f} s."
    return lines


def _bounds(reports: Sequence[EffectReport]) -> Iterator[tuple[list[float], str]]:
    """Bounds of one effect, of each unit."""
    unit = {"cents": "cent"}.get(reports[0].unit, reports[0].unit)
    for values, name in (([r.bound for r in reports], unit), ([r.bound_db for r in reports], "dB")):
        used = [value for value in values if value is not None]
        if used:
            yield used, name


def report(rendered: WrittenSound) -> dict[str, Any]:
    """Everything as plain values."""
    renderer, peak = rendered.renderer, rendered.peak
    s, account = renderer.summary(), renderer.energy
    return {
        "output": str(rendered.output),
        "outputs": [group.name for group in renderer.model.outputs],
        "fs": s.fs,
        "frames": s.frames,
        "channels": len(renderer.channels),
        "channel_names": list(renderer.channels),
        "duration_s": s.duration_s,
        "load_s": rendered.load_s,
        "render_s": s.render_s,
        "realtime_factor": s.realtime_factor,
        "n_modes": s.n_modes,
        "notes": s.notes,
        "notes_dropped": [
            {"time_s": d.time, "note": d.note, "channel": d.channel, "reason": d.reason} for d in s.notes_dropped
        ],
        "midi_ignored": dict(s.ignored),
        "peak_dbfs": decibel(peak) if peak > 0 else None,
        "clipped": rendered.clipped,
        "end": s.end,
        "tensions": [{**asdict(t), "cents": t.cents} for t in s.tensions],
        "zero_frame": s.zero_frame,
        "onset_step_dbfs": s.onset_step_dbfs,
        "room": s.room,
        "warnings": rendered.warnings(),
        "energy": None if account is None else account.balance(),
        "effects": [asdict(e) for e in s.effects],
        "level": rendered.level,
        "gain_db": rendered.gain_db,
    }
