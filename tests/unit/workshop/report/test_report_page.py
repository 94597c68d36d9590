"""The page of a comparison: whole, offline, escaped, and in a browser sample for sample as rendered."""

from __future__ import annotations

import base64
import io
import re
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf
from matplotlib.figure import Figure

import tonewood as tw
from browser import CHROMIUM, dom, listening, opened
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.workshop.report import figures
from tonewood.workshop.report.comparison import (
    Candidate,
    Comparison,
    ModeMatch,
    NoteMatch,
    ParameterRow,
    WolfMatch,
    compare,
    match_wolves,
)
from tonewood.workshop.report.page import page
from tonewood.workshop.report.summary import key_figures, value_words

FS = 48000
EVIL = '<script>document.title="owned"</script> & "two" $x_1$'


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """The monochord and one with an unkind title, source and change."""
    folder = tmp_path_factory.mktemp("evil")
    source = tw.list_instruments()["monochord"]
    (folder / "body.csv").write_text((source / "body.csv").read_text(encoding="utf-8"))
    text = (source / "instrument.yaml").read_text(encoding="utf-8")
    quoted = EVIL.replace('"', '\\"')
    text = re.sub(r"^title: .*$", lambda _: f'title: "{quoted}"', text, flags=re.MULTILINE)
    text = text.replace(
        "sources: {}", f'description: "{quoted}"\nsources: {{lab: {{text: "{quoted}", licence: facts}}}}'
    )
    (folder / "instrument.yaml").write_text(text, encoding="utf-8")
    evil = tw.load_instrument(folder).replace({"strings.A2.tension": 50.0, "strings.A2.loss.sigma0": 3.0})
    both = [Candidate(tw.load_instrument("monochord")), Candidate(evil, (EVIL,))]
    return compare(both, notes=["A2"], fs=FS, duration=1.0)


@pytest.fixture(scope="module")
def html(found: Comparison) -> str:
    return page(found)


class Reader(HTMLParser):
    """Tags with their attributes, and text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.mark.slow
def test_nothing_is_fetched(html: str) -> None:
    read = Reader(html)
    sources = [a["src"] or "" for tag, a in read.tags if "src" in a]
    assert len(sources) >= 7
    assert all(source.startswith("data:") for source in sources)
    assert not [a for tag, a in read.tags if tag in ("link", "iframe", "object", "embed", "form")]
    assert all((a["href"] or "").startswith("#") for a in read.all("a"))
    (policy,) = [a["content"] or "" for a in read.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    ids = {a["id"] for _, a in read.tags if "id" in a}
    assert {(a["href"] or "")[1:] for a in read.all("a")} <= ids


def test_texts_of_a_bundle_are_escaped(html: str) -> None:
    read = Reader(html)
    assert len(read.all("script")) == 1
    assert "".join(read.texts).count(EVIL) >= 4  # title, description, source, change
    assert "<script>document" not in html


def test_figures_have_text_and_sounds_are_the_rendered_ones(found: Comparison, html: str) -> None:
    read = Reader(html)
    assert all(a["alt"] for a in read.all("img"))
    for facts, audio in zip(found.instruments, read.all("audio"), strict=True):
        sound, fs = sf.read(io.BytesIO(base64.b64decode((audio["src"] or "").partition(",")[2])), always_2d=True)
        rendered = facts.tones["A2"].samples
        assert fs == FS
        assert len(sound) == len(rendered) == FS
        middle = slice(0, FS // 2)
        gain = np.sum(sound[middle] * rendered[middle]) / np.sum(rendered[middle] ** 2)
        assert np.abs(sound[middle] - gain * rendered[middle]).max() <= 2.0**-15


def test_numbers_of_the_page_are_those_of_the_facts(found: Comparison, html: str) -> None:
    text = " ".join(Reader(html).texts)
    for facts in found.instruments:
        assert f"{facts.strings[0].tension:.2f}" in text
        for mode in facts.body_modes:
            assert f"{mode.freq:.2f}" in text
        for wolf in facts.wolves:
            assert f"{wolf.severity_cents:.1f}" in text
    assert "strings.A2.loss.sigma0" in text


def test_a_report_of_one(found: Comparison) -> None:
    """No players, no parameters that differ; sources and stand-ins."""
    facts = replace(found.instruments[1], stand_ins={"body.table": EVIL})
    matches = dict.fromkeys(("modes", "wolves", "notes", "parameters"), ())
    html = page(replace(found, instruments=(facts,), tones=(), **matches))
    read = Reader(html)
    text = " ".join(read.texts)
    assert "Stand-ins, for figures nobody has published" in text
    assert text.count(EVIL) >= 4
    assert "Parameters that differ" not in text
    assert not read.all("button")


#: played without a clock: B is chosen half-way, and the sum is compared with both sounds
PROBE = """<script>
const tell = words => new Image().src = "http://127.0.0.1:%d/" + encodeURIComponent(words);
let made = null;
window.AudioContext = function () {
  made = new OfflineAudioContext(2, 48000, 48000);
  made.resume = () => Promise.resolve();
  return made;
};
window.addEventListener("load", async () => {
  try {
    const player = document.querySelector(".player");
    const starts = [];
    const start = AudioBufferSourceNode.prototype.start;
    AudioBufferSourceNode.prototype.start = function (when) {
      starts.push([when, this]);
      return start.call(this, when);
    };
    player.querySelector("[data-play]").click();
    while (starts.length < 2) await new Promise(done => setTimeout(done, 20));
    const resume = OfflineAudioContext.prototype.resume;
    made.suspend(0.5).then(() => { player.querySelectorAll("[data-sound]")[1].click(); resume.call(made); });
    const sum = (await made.startRendering()).getChannelData(0);
    const shift = Math.round(starts[0][0] * 48000), switched = 24000, crossed = 24000 + 960 + 128;
    const [a, b] = starts.map(([, source]) => source.buffer.getChannelData(0));
    let before = 0, after = 0, apart = 0, hull = 0;
    for (let i = shift; i < 47000; i++) {
      const x = a[i - shift], y = b[i - shift];
      if (i < switched) before = Math.max(before, Math.abs(sum[i] - x));
      else if (i >= crossed) after = Math.max(after, Math.abs(sum[i] - y));
      hull = Math.max(hull, sum[i] - Math.max(x, y), Math.min(x, y) - sum[i]);
      apart = Math.max(apart, Math.abs(x - y));
    }
    tell(["done", starts[0][0] === starts[1][0], before, after, hull, apart, player.dataset.chosen].join(" "));
  } catch (fault) { tell("fault " + fault); }
});
</script>
</head>"""


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_players_switch_without_a_gap(html: str, tmp_path: Path) -> None:
    """Before the switch the output is A, 20 ms after it B at the same place, and between them never outside of both."""
    probed = tmp_path / "probed.html"
    free = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", html)
    with listening() as (port, reported):
        probed.write_text(free.replace("</head>", PROBE % port, 1), encoding="utf-8")
        with opened(probed, tmp_path / "profile"):
            words = reported.get(timeout=120)
    done, together, before, after, hull, apart, chosen = words.split(" ")
    assert (done, together, chosen) == ("done", "true", "1"), words
    assert float(apart) > 0.02
    assert max(float(before), float(after), float(hull)) < 1e-5


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_policy_lets_the_page_s_own_script_run_and_no_other(html: str, tmp_path: Path) -> None:
    tampered = tmp_path / "tampered.html"
    foreign = "<script>document.body.dataset.foreign = 'ran'</script></body>"
    tampered.write_text(html.replace("</body>", foreign), encoding="utf-8")
    shown = dom(tampered, tmp_path / "profile")
    assert 'data-state="stopped"' in shown
    assert 'data-foreign="ran"' not in shown
    assert "<title>owned" not in shown


def test_the_worst_wolves_are_drawn_by_name(found: Comparison) -> None:
    """One bar of an instrument for each: 57 cents near A3, none of the other instrument's."""
    wolf = WolfNote("A2", 205.0, 226.0, 220.0, 0.5, 50.0, 57.0, 216.0, ())
    assert figures.wolf_picture(replace(found, wolves=())) is None
    picture = figures.wolf_picture(replace(found, wolves=tuple(match_wolves([[wolf], []]))))
    assert picture is not None
    svg = base64.b64decode(picture.uri.partition(",")[2]).decode()
    assert "A2 near A3" in svg
    assert "severity" in svg


def test_the_louder_of_two_notes_is_inside_its_picture(found: Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = found.instruments
    tone = second.tones["A2"]
    louder = replace(tone, level_db=first.tones["A2"].level_db.max() + 30.0 + 0.0 * tone.level_db)
    drawn: list[Figure] = []
    monkeypatch.setattr(figures, "_svg", lambda made: drawn.append(made) or "")
    figures.decay_picture(replace(found, instruments=(first, replace(second, tones={"A2": louder}))), "A2")
    low, high = drawn[0].axes[0].get_ylim()
    assert low < 0.0 < 30.0 < high
    assert [line.get_ydata().max() for line in drawn[0].axes[0].lines] == pytest.approx([0.0, 30.0])


def crowded(found: Comparison) -> Comparison:
    """Six instruments with many modes, wolf notes, notes and parameters."""
    first, second = found.instruments
    tone = first.tones["A2"]
    notes = tuple(f"A2:{k}" for k in range(8))
    six = [replace(second, label=label, name=f"another {label}", wolves=()) for label in "BCDEF"]
    every = tuple(replace(f, tones=dict.fromkeys(notes, tone)) for f in (first, *six))
    modes = [replace(first.body_modes[0], freq=100.0 + 10 * k) for k in range(120)]
    wolf = WolfNote("A2", 205.0, 226.0, 220.0, 0.5, 50.0, 57.0, 216.0, (12,))
    keys = [
        ParameterRow(f"strings.A2.some.long.key.number_{k}", ("a rather long value of it",) * 6, "N") for k in range(90)
    ]
    return replace(
        found, instruments=every, tones=notes, modes=tuple(ModeMatch((mode,) * 6) for mode in modes),
        wolves=tuple(WolfMatch((wolf,) * 6) for _ in range(20)), parameters=tuple(keys),
        notes=tuple(NoteMatch("A2", k, (first.notes[0],) * 6) for k in range(20)),
    )  # fmt: skip


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("many", [False, True])
def test_a_comparison_prints_on_six_a4_pages_with_nothing_cut_off(
    found: Comparison, tmp_path: Path, many: bool
) -> None:
    text = page(crowded(found) if many else found)
    printed, pdf = tmp_path / "printed.html", tmp_path / "printed.pdf"
    printed.write_text(text, encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    subprocess.run([str(CHROMIUM), *options, f"--print-to-pdf={pdf}", printed.as_uri()], check=True, timeout=120,
                   capture_output=True)  # fmt: skip
    boxes = re.findall(rb"/MediaBox ?\[([^]]*)\]", pdf.read_bytes())
    assert 1 <= len(re.findall(rb"/Type ?/Page\b", pdf.read_bytes())) <= 6
    for box in boxes:  # A4 in points
        assert [float(x) for x in box.split()] == pytest.approx([0, 0, 595, 842], abs=1.5)
    # the same style in a window as wide as the paper between its margins, 186 mm at 96 dpi
    free = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text).replace(
        "@media print {", "@media all {"
    )
    probe = (
        "<script>document.title = [document.documentElement.scrollWidth, window.innerWidth].join(' ')</script></body>"
    )
    printed.write_text(free.replace("</body>", probe), encoding="utf-8")
    shown = subprocess.run(
        [str(CHROMIUM), *options, "--window-size=703,1000", "--hide-scrollbars", "--dump-dom", printed.as_uri()],
        check=True, timeout=120, capture_output=True, text=True,
    ).stdout  # fmt: skip
    wide, window = re.search(r"<title>(\d+) (\d+)</title>", shown).groups()  # type: ignore[union-attr]
    assert int(wide) <= int(window) == 703


def test_what_changed_stands_before_mobility_and_that_before_spectrograms(html: str) -> None:
    places = [
        html.index(text) for text in ('id="summary"', 'id="mobility"', 'id="modes"', "Spectrograms", 'id="sources"')
    ]
    assert places == sorted(places)
    assert "the least noticed" in html


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures as they are made."""
    made: list[Figure] = []
    monkeypatch.setattr(figures, "_svg", lambda figure: made.append(figure) or "")
    return made


def test_curves_of_mobility_are_those_of_the_facts(found: Comparison, drawn: list[Figure]) -> None:
    """Of several instruments, a curve of each at the first end and at the last; their difference below."""
    figures.mobility_picture(found)
    ends = list(found.instruments[0].mobility)
    assert len(drawn[0].axes) == len({ends[0], ends[-1]}) + 1
    for axes, name in zip(drawn[0].axes[:-1], dict.fromkeys((ends[0], ends[-1])), strict=True):
        for line, facts in zip(axes.lines, found.instruments, strict=False):
            np.testing.assert_allclose(line.get_xdata(), facts.freq)
            np.testing.assert_allclose(line.get_ydata(), 20 * np.log10(np.abs(facts.mobility[name])), atol=1e-9)


@pytest.mark.slow
def test_a_sweep_is_a_table_and_curves_over_its_value(found: Comparison, drawn: list[Figure]) -> None:
    """The unkind monochord has 50 N, the other one 58.8 N: rows in the order of values, with the label of each."""
    swept = replace(found, sweep="strings.A2.tension")
    texts = [text.strip() for text in Reader(page(swept)).texts if text.strip()]
    rows = [key_figures(facts) for facts in reversed(found.instruments)]
    names = list(rows[0])
    table = [*names]
    for first, row in zip(("50 (B)", "58.8 (A)"), rows, strict=True):
        table += [first, *(value_words(*row[name]) for name in names)]
    begin = texts.index(names[0])
    assert texts[begin : begin + len(table)] == table
    panels = next(figure for figure in drawn if figure.axes[0].lines[0].get_xdata().tolist() == [50.0, 58.8])
    shown = [axes for axes in panels.axes if axes.lines]
    assert len(shown) == len([name for name in names if all(name in row for row in rows)])
    for axes, name in zip(shown, names, strict=True):
        np.testing.assert_allclose(axes.lines[0].get_ydata(), [row[name][0] for row in rows], rtol=1e-12)


@pytest.mark.parametrize("quantity", ["t60", "cents_mounted"])
def test_points_of_notes_are_those_of_the_facts(found: Comparison, drawn: list[Figure], quantity: str) -> None:
    figures.notes_picture(found, quantity)
    for i, line in enumerate(drawn[0].axes[0].lines[:2]):
        values = [np.nan if (note := match.notes[i]) is None else getattr(note, quantity) for match in found.notes]
        np.testing.assert_allclose(line.get_ydata(), np.where(np.isfinite(values), values, np.nan))
        np.testing.assert_allclose(line.get_xdata(), [match.stop for match in found.notes])


@pytest.mark.parametrize(("count", "named"), [(6, True), (24, True), (30, False)])
def test_open_strings_are_named_where_there_is_room(
    found: Comparison, drawn: list[Figure], count: int, named: bool
) -> None:
    notes = tuple(replace(found.notes[0], string=f"string {k}", stop=0) for k in range(count))
    figures.notes_picture(replace(found, notes=notes), "t60")
    shown = [label.get_text() for label in drawn[0].axes[0].get_xticklabels()]
    assert (shown == [f"string {k}" for k in range(count)]) is named


def test_the_loudest_of_two_spectrograms_is_the_top_of_both(found: Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    """At one loudness; levels are told from the loudest of all."""
    draw, levels = figures.draw_spectrogram, list[float]()

    def watched(axes: object, time: object, freq: object, level: np.ndarray, **options: float) -> object:
        levels.append(float(level.max()))
        return draw(axes, time, freq, level, **options)

    monkeypatch.setattr(figures, "draw_spectrogram", watched)
    figures.spectrogram_picture(found, "A2")
    assert len(levels) == 2
    assert max(levels) == 0.0 > min(levels)
