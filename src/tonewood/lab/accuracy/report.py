"""The whole study as one text: Markdown, or a page that needs nothing but itself."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tonewood.lab.accuracy import least_time
from tonewood.lab.accuracy.outcome import Outcome
from tonewood.lab.accuracy.tables import expectation, headline_tables, section, summary_table, to_json
from tonewood.support.page.offline import offline_page
from tonewood.support.plotting import data_uri

INTRODUCTION = """\
## How it is measured

Every method steps the same modes of the same system with the same compiler flags, so that their times can be compared:
only the integrator differs, and the level at which the connections are held together. All systems are held still by
a constant force and let go; nothing but the method's own stepping then makes an error.

- **tonewood**: exact flow of every mode under forces held over a step, gaps closed at its end; modes above 0.45 of the
  rate are replaced by their compliance. *A sweep per sample* is the same scheme in the loop of the other methods.
- **Adams-Bashforth 3** on Udwadia and Kalaba's equation in complex modes (Fabre et al. 2024), just above its limit of
  stability and further up; **velocity Verlet** on it in real modes (Antunes & Debut 2017).
- **P0, P1, P2, trapezoidal, Simpson**: the updates of modes under known forces are those of Chinnakonda (2007); that
  the force is found from a constraint on accelerations at sampling instants and continued over the step is this
  project's construction, not the thesis's. **Held force, velocity constraint** and **P1, position constraint** are two
  near neighbours.
- **Newmark** (average acceleration) and **HHT-alpha**, accelerations of the gaps zero at the end of a step.
- **Superposition** of the coupled modes of the whole: the floor, where everything is linear and nothing ever changes.

Methods of second order in time take real modes only: there, bodies of complex modes are replaced by their proportional
approximation, whose own true poles such a method is held against.

- **Pitch and decay** are read from the poles that a method puts in place of the true ones, for partials 1 to 40. A
  partial farther off than half its distance to the next is lost.
- **Waveform**: ||y - y_true|| / ||y_true|| of the displacement over the first second (40 ms at the obstacle and 0.2 s
  of the tension-modulated string, which amplify small differences).
- **Spectrum**: rms difference of third-octave levels of the acceleration, 50 Hz to 16 kHz, in bands within 80 dB of
  the loudest, under a Hann window. **Spurious**: the largest acceleration farther than 20 Hz from every true partial.
- **Energy drift** of the same system without damping, within the first second.
- **Time**: processor time of one thread per second of sound, all methods in turn, median (10th and 90th percentile).

Dials of tonewood, turned one at a time at 48 kHz: the frequency up to which strings are solved; modes of the solved
basis dropped, with and without their compliance; modes of a string that slides at the bridge (cosines) instead of
fixed-base modes and a ramp. Contacts are solved to rounding, in as many Newton steps as the points' notes in
the JSON file tell (1 to 3 on average): that is no dial, for a solution left early is not one that cannot gain energy.

A time ratio at equal error is read from the Pareto line of each method, straight in the logarithms of time and error
between measured points. *Not reached*: no measured point of the method is that good. *Not stable*: none is stable.
*Partials lost*: every stable one has lost some. Where methods stay stable at all, by modes, force and sampling rate:
`tonewood accuracy --stability`."""

TABLES = """For readers who check [the cost of accuracy](accuracy.md). Here are all points behind it: every method and
setting on every system."""
READING = """\
A cell has the cheapest setting of tonewood that was measured with an error no larger (sampling rate, or the highest
mode of strings at 48 kHz), its seconds of computing per second of sound, and the best other method with its time as a
multiple of ours. All methods step the same modes of the same system, compiled alike, so a multiple has two factors: the
scheme, and cache blocking (modes are moved once per block of samples), which the other methods were not given. The
second one alone is the ratio of *tonewood's scheme, a sweep per sample* in the [tables](accuracy-tables.md). *Velocity
level* is that scheme with the velocities of a joint made equal instead of its positions: no published method, of second
order, and unstable with modes above the Nyquist frequency.
*Superposition* of the coupled modes has no error of pitch or waveform at any rate, as long as no stop, bend or contact
changes; the eigenproblem of the whole is not in its time.

For an instrument of your own: `tonewood accuracy -i INSTRUMENT --target 1cent` prints the cheapest setting, its
cost and the settings around it, with the own error of the reference that it judges by. Targets are pitch (`1cent`),
decay (`5%decay`), level (`0.5dB`) and waveform (`-60dB`) of the worst partial, or several with commas; `--notes` names
notes, `--plot` draws the frontier, and `--apply` prints the options alone:

<!-- run in part: 20 s -->
```sh
echo $(tonewood accuracy -i monochord --target 1cent --apply)
```"""

SHORT = """\
## In short

tonewood at 48 kHz (problem D: at the middle one of its rates): worst pitch error of partials 1 to 40, error of the
waveform, seconds of computing per second of sound. The others: how many times as long they compute for the same error
of the waveform (at the hard obstacle: of the pitch), or the smallest error of theirs that was measured, and at how many
times our time."""

HEADLINE = """\
## Time ratio at equal error

How many times as long as tonewood each method computes for the error that tonewood has at 48 kHz (problem D, whose
frequencies are low: at the middle one of its rates)."""


@dataclass(frozen=True, eq=False)
class Study:
    """Result of a study, where and how thoroughly it was found.

    outcomes : one per system.
    machine : of `timing.machine`.
    quick : fewer points and repeats.
    more : further sections: key in JSON -> (Markdown, JSON).
    """

    outcomes: Sequence[Outcome]
    machine: Mapping[str, object]
    quick: bool
    more: Mapping[str, tuple[str, object]] = field(default_factory=dict)

    def to_json(self) -> dict[str, object]:
        """``{"machine": ..., "quick": ..., "systems": [...], ...}``."""
        plain = {"machine": self.machine, "quick": self.quick, "systems": [to_json(o) for o in self.outcomes]}
        return plain | {key: value for key, (_, value) in self.more.items()}

    @property
    def machine_line(self) -> str:
        """Processor and instruction set."""
        m = self.machine
        peak = f"{float(str(m['fma_peak'])) / 1e9:.1f} G multiply-adds/s"
        return f"{m['processor']}, {m['system']}, {m['instruction_set']}, one core, measured peak {peak}"

    def markdown(self, picture: str | None = None) -> str:
        """The page, without its appendix; `picture` is the path of the chart as seen from it."""
        parts = ["# What does one cent cost?", least_time.section(self.outcomes)]
        if picture is not None:
            parts.append(f"![Error against time, one system and one quantity a row]({picture})")
        parts += [READING, self._provenance, *(text for text, _ in self.more.values()), INTRODUCTION]
        return "\n\n".join(part for part in parts if part) + "\n"

    def tables(self) -> str:
        """The appendix: every point of every system."""
        parts = ["# What accuracy costs: tables", TABLES, self._provenance, SHORT, summary_table(self.outcomes)]
        parts += [HEADLINE, headline_tables(self.outcomes)]
        parts += [expectation(o) for o in self.outcomes if o.name == "fabre_guitar"]
        parts += [section(o).rstrip() for o in self.outcomes]
        return "\n\n".join(parts) + "\n"

    @property
    def _provenance(self) -> str:
        command = f"tonewood accuracy{' --quick' * self.quick} --report FILE.md --plot FILE.png"
        return f"Printed by `{command}`. Machine: {self.machine_line}; a shared one: compare times as ratios."

    def html(self, png: bytes) -> str:
        """The page with its picture inside. Raises TonewoodError : jinja2 is not installed."""
        text = self.markdown(data_uri(png, "image/png")) + "\n" + self.tables()
        heading, _, body = text.partition("\n")
        return offline_page(_PAGE, title=heading.lstrip("# "), body=_html(body))


_PAGE = '{% from "parts" import head, foot with context -%}{{ head(title) }}\n{{ body | safe }}\n{{ foot() }}'


def _html(text: str) -> str:
    """Return headings, paragraphs, lists, tables and pictures, as they occur here, as HTML."""
    out = []
    for block in text.strip().split("\n\n"):
        lines = block.splitlines()
        if block.startswith("!["):
            label, _, source = block[2:-1].partition("](")
            out.append(f'<p><img alt="{html.escape(label)}" src="{html.escape(source)}"></p>')
        elif block.startswith("<!--"):
            code = "\n".join(line for line in lines if not line.startswith(("<!--", "```")))
            out.append(f"<pre>{html.escape(code)}</pre>")
        elif block.startswith("#"):
            level = len(block) - len(block.lstrip("#"))
            out.append(f"<h{level}>{_inline(block.lstrip('# '))}</h{level}>")
        elif block.startswith("|"):
            rows = [line.strip("|").split("|") for line in lines if set(line) - set("|-: ")]
            cells = [
                "".join(f"<{tag}>{_inline(c.strip())}</{tag}>" for c in row)
                for row, tag in zip(rows, ["th"] + ["td"] * len(rows), strict=False)
            ]
            table = "".join(f"<tr>{row}</tr>" for row in cells)
            out.append(f'<div class="scroll"><table>{table}</table></div>')
        elif block.startswith("- "):
            items = block[2:].split("\n- ")
            out.append("<ul>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + "</ul>")
        else:
            out.append(f"<p>{_inline(block)}</p>".replace("\n", "<br>\n" if len(lines) < 4 else "\n"))
    return "\n".join(out)


def _inline(text: str) -> str:
    parts = html.escape(text).split("**")
    text = "".join(f"<b>{part}</b>" if i % 2 else part for i, part in enumerate(parts))
    parts = text.split("`")
    return "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))
