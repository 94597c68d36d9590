"""Damaged and hostile scores of every format, from a seed: numbers, elements and bytes changed in files that are read.

Run as a program it reads many of them in one process of limited memory and time, and prints their faults:

    python mutations.py FORMAT SEED COUNT
"""

from __future__ import annotations

import io
import random
import re
import resource
import struct
import sys
import tempfile
import time
import traceback
import zipfile
from pathlib import Path

from smf_bytes import event, meta, smf, tempo, vlq
from tablatures import MUSICXML, enabled, gpif, guitar_pro, musicxml, note

#: texts in the place of numbers
NUMBERS = (
    "", "0", "-0", "-1", "1", "2", "3", "7", "-5", "--5", "-", "+", ".", "0.5", "1/3", "nan", "inf", "-inf", "1e9",
    "1e308", "1e-308", "-1e308", "1e999", "9" * 30, "9" * 5000, "²", "٣", "1_000", "0x10", "1,2,x", "0th", "1th",
    "4294967296", "-2147483648", "255", "1000", "65536", "0.0001", " 5 ", "5 5", "1 " * 200,
)  # fmt: skip
_NUMBER = re.compile(r"(?<=[>\"/ ])-?[0-9]+(?:\.[0-9]+)?(?=[<\"/ ])")
_ELEMENT = re.compile(r"<([A-Za-z-]+)(?: [^<>]*)?(?:/>|>(?:[^<>]|<(?!/\1>)[^<>]*>)*</\1>)")

FOUR = "".join(
    note(step, octave, 4, f"<string>{s}</string><fret>{f}</fret>{more}", ornaments, before)
    for step, octave, s, f, more, ornaments, before in (
        ("E", 2, 6, 0, "<bend><bend-alter>2</bend-alter></bend>", "", ""),
        ("B", 2, 5, 2, "<hammer-on type='stop'/>", "<ornaments><tremolo>3</tremolo></ornaments>", ""),
        ("G", 3, 4, 5, "", "<ornaments><trill-mark/><wavy-line/></ornaments>", ""),
        ("D", 4, 3, 7, "", "<articulations><staccato/></articulations><arpeggiate/>", "<chord/>"),
        ("D", 4, 3, 7, "", "", "<grace/>"),
    )
)
SIGNS = """<barline><ending number="1, 2" type="start"/><repeat direction="backward" times="3"/></barline>
<direction><sound tempo="90" dynamics="80" segno="a" dalsegno="a"/></direction><attributes><divisions>3</divisions>
<transpose><chromatic>-2</chromatic><octave-change>1</octave-change></transpose></attributes>
<backup><duration>4</duration></backup><forward><duration>2</duration></forward>"""


def musicxml_text(source: random.Random) -> bytes:
    """MusicXML, now and then by measures or in UTF-16."""
    text = mutated_text(musicxml(FOUR + SIGNS + FOUR), source)
    if source.random() < 0.1:
        swapped = {"score-partwise": "score-timewise", "<part ": "<measure ", "</part>": "</measure>"}
        swapped |= {"<measure number": "<part id", "</measure>": "</part>"}
        text = re.sub("|".join(map(re.escape, swapped)), lambda m: swapped[m[0]], text)
    return text.encode("utf-16" if source.random() < 0.05 else "utf-8", "surrogatepass")


def musicxml_archive(source: random.Random) -> bytes:
    """The same, compressed; bytes of the archive are changed, too."""
    container = '<container><rootfiles><rootfile full-path="score.xml"/></rootfiles></container>'
    return _archive({"META-INF/container.xml": container.encode(), "score.xml": musicxml_text(source)}, source)


def gpif_archive(source: random.Random) -> bytes:
    """Guitar Pro 7."""
    bend = "".join(
        f'<Property name="Bend{name}"><Float>{value}</Float></Property>'
        for name, value in (("OriginValue", 0), ("DestinationValue", 100), ("DestinationOffset", 50))
    )
    slide = '<Property name="Slide"><Flags>2</Flags></Property>'
    harmonic = enabled("Harmonic") + '<Property name="HarmonicType"><HType>Natural</HType></Property>'
    with tempfile.TemporaryDirectory() as folder:
        notes = [
            (0, 0, enabled("Bended") + bend, "<Vibrato/>"), (1, 2, slide, "<Trill>50</Trill>"),
            (2, 5, enabled("HopoOrigin") + harmonic, "<Accent>5</Accent>"), (3, 7, "", '<Tie destination="true"/>'),
        ]  # fmt: skip
        path = gpif(Path(folder) / "study.gp", notes, rhythm=source.randrange(2), capo=2)
        with zipfile.ZipFile(path) as archive:
            text = archive.read("Content/score.gpif").decode()
    bar = '<Repeat start="true" end="true" count="2"/><AlternateEndings>1 2</AlternateEndings><Time>3/4</Time>'
    text = text.replace("<MasterBar>", "<MasterBar>" + bar * source.randrange(2))
    text = text.replace("<NoteValue>Q", '<AugmentationDot count="1"/><NoteValue>Q').replace("Eighth", "16th")
    text = mutated_text(text, source)
    for name in ("Notes", "Beats", "Voices", "Bars"):  # lists that multiply
        if source.random() < 0.05:
            many = 10 ** source.randrange(1, 5)
            text = re.sub(
                rf"<{name}>([^<]*)</{name}>", lambda m, n=many, k=name: f"<{k}>{(m[1] + ' ') * n}</{k}>", text
            )
    return _archive({"Content/score.gpif": text.encode("utf-8", "surrogatepass")}, source)


def guitar_pro_bytes(source: random.Random) -> bytes:
    """Guitar Pro 3, 4 or 5."""
    import guitarpro as gp

    def change(song: gp.Song, beats: list[gp.Beat]) -> None:
        beats[0].notes[0].effect.bend = gp.BendEffect(points=[gp.BendPoint(0, 0), gp.BendPoint(12, 4)])
        beats[1].notes[0].effect.grace = gp.GraceEffect(fret=1)
        beats[2].notes[0].type = gp.NoteType.tie
        beats[3].notes[0].effect.hammer = True
        song.tracks[0].measures[0].header.repeatClose = 2

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / source.choice(("study.gp3", "study.gp4", "study.gp5"))
        data = bytearray(guitar_pro(path, change).read_bytes())
    for _ in range(source.choice((1, 1, 2, 5, 20))):
        place = source.randrange(31, len(data))
        if source.random() < 0.5:
            data[place] = source.choice((0, 1, 2, 127, 128, 254, 255, source.randrange(256)))
        else:
            number = source.choice((0, -1, 1, 2**31 - 1, -(2**31), 1000, 100_000, source.randrange(70000)))
            data[place : place + 4] = struct.pack("<i", number)
    if source.random() < 0.1:
        del data[source.randrange(len(data)) :]
    if source.random() < 0.1:
        place = source.randrange(len(data))
        data += data[place:] * source.randrange(1, 1 + 300_000 // max(len(data) - place, 100))
    return bytes(data)


def midi_bytes(source: random.Random) -> bytes:
    """MIDI of format 0 to 2, of events with extreme numbers, and bytes of it changed."""

    def track() -> bytes:
        out = []
        for _ in range(source.randrange(1, 60)):
            delta = source.choice((0, 0, 1, 10, 480, 2**28 - 1 if source.random() < 0.02 else 96))
            a, b = source.choice((0, 1, 6, 7, 64, 66, 100, 101, 120, 123, 127, source.randrange(128))), 0
            b = source.choice((0, 1, 64, 127, source.randrange(128)))
            status = source.choice((0x90, 0x90, 0x80, 0xB0, 0xE0, 0xA0)) | source.choice((0, 0, 9, 15))
            piece = event(delta, status, a, b)
            kind = source.random()
            if kind < 0.1:
                piece = tempo(delta, source.choice((1, 500_000, 2**24 - 1)))
            elif kind < 0.15:
                piece = meta(delta, source.randrange(128), bytes(source.randrange(5)), source.choice((None, 2**27)))
            elif kind < 0.2:
                piece = vlq(delta) + bytes([source.choice((0xF0, 0xF7, 0xF8, 0xC0, 0xD0)), source.randrange(256)])
            out.append(piece * (source.choice((1, 1, 1, 1, 1, 1, 1, 1, 300))))
        return b"".join(out)

    division = source.choice((480, 1, 32767, 0, 0xE728, 0xE200, 0x8001))
    bodies = [track() for _ in range(source.choice((1, 1, 2, 16)))]
    data = bytearray(smf(*bodies, form=source.choice((0, 1, 2, 7)), division=division))
    for _ in range(source.choice((0, 0, 1, 3, 10))):
        data[source.randrange(4, len(data))] = source.randrange(256)
    if source.random() < 0.1:
        del data[source.randrange(4, len(data)) :]
    return bytes(data)


def mutated_text(text: str, source: random.Random) -> str:
    """XML with numbers replaced, elements doubled, moved, nested and removed, and characters changed."""
    for _ in range(source.choice((1, 1, 2, 4, 10))):
        kind = source.random()
        if kind < 0.5 and (numbers := list(_NUMBER.finditer(text))):
            number = source.choice(numbers)
            text = text[: number.start()] + source.choice(NUMBERS) + text[number.end() :]
        elif kind < 0.9 and (elements := list(_ELEMENT.finditer(text))):
            one, other = source.choice(elements), source.choice(elements)
            times = source.choice((0, 0, 2, 2, 3, 30, 3000))
            whole = one[0] * times if kind < 0.75 else other[0]
            if kind > 0.85:
                whole = f"<{one[1]}>" * 50 + whole + f"</{one[1]}>" * 50
            if len(text) + len(whole) < 2_000_000:
                text = text[: one.start()] + whole + text[one.end() :]
        else:
            place = source.randrange(len(text))
            text = text[:place] + source.choice('<>/"&;0-9eE.\x00\ud800\U0001f3b8') + text[place + 1 :]
    return text


def _archive(members: dict[str, bytes], source: random.Random) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    data = bytearray(out.getvalue())
    for _ in range(source.choice((0, 0, 0, 0, 1, 5))):
        data[source.randrange(2, len(data))] = source.randrange(256)
    return bytes(data)


FORMATS = {
    "musicxml": musicxml_text, "mxl": musicxml_archive, "gp7": gpif_archive, "gp5": guitar_pro_bytes,
    "mid": midi_bytes,
}  # fmt: skip
#: s of the processor and MB above an idle interpreter that any file may take
MOST_SECONDS, MOST_MEGABYTES = 10.0, 300


def resident_mb() -> int:
    """Largest resident memory of this process so far, MB."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+)", status)[1]) // 1024  # type: ignore[index]


def main(kind: str, seed: int, count: int) -> None:
    """Read files from a seed on; print a line for each that breaks a promise, and how many were read and refused."""
    import guitarpro  # noqa: F401

    from tonewood.errors import TonewoodError
    from tonewood.performance.score.reading import read_score

    assert MUSICXML
    resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
    before, read, refused, slowest = resident_mb(), 0, 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "score"
        for i in range(seed, seed + count):
            path.write_bytes(FORMATS[kind](random.Random(i)))
            began = time.process_time()
            resource.setrlimit(resource.RLIMIT_CPU, (int(began + 2 * MOST_SECONDS) + 1, resource.RLIM_INFINITY))
            try:
                score = read_score(path)
                read += 1
                if not all(n.time >= 0.0 and n.duration > 0.0 for n in score.notes):
                    print(f"BAD {kind} {i}: a note without time", flush=True)
            except TonewoodError as error:
                refused += 1
                if "\n" in str(error) or str(path) not in str(error):
                    print(f"BAD {kind} {i}: not one line that names the file: {error!r}", flush=True)
            except BaseException:
                print(f"BAD {kind} {i}: {traceback.format_exc()[-600:]}", flush=True)
            seconds = time.process_time() - began
            slowest = max(slowest, seconds)
            if seconds > MOST_SECONDS or resident_mb() - before > MOST_MEGABYTES:
                print(f"BAD {kind} {i}: {seconds:.1f} s, {resident_mb() - before} MB", flush=True)
                before = resident_mb()
    print(f"{kind}: {read} read, {refused} refused, slowest {slowest:.2f} s, {resident_mb() - before} MB")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
