"""One small piece in every format that guitarists use, made by other programs or by hand."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import Any

MUSICXML = """<?xml version="1.0"?>
<!DOCTYPE score-partwise PUBLIC "-//Recordare//DTD MusicXML 4.0 Partwise//EN" "http://www.musicxml.org/dtds/partwise.dtd">
<score-partwise version="4.0"><work><work-title>Study</work-title></work>
<part-list><score-part id="P1"><part-name>Guitar</part-name></score-part></part-list>
<part id="P1"><measure number="1"><attributes><divisions>4</divisions>
<staff-details><staff-tuning line="1"><tuning-step>E</tuning-step><tuning-octave>2</tuning-octave></staff-tuning>
<staff-tuning line="2"><tuning-step>A</tuning-step><tuning-octave>2</tuning-octave></staff-tuning>
<staff-tuning line="3"><tuning-step>D</tuning-step><tuning-octave>3</tuning-octave></staff-tuning>
<staff-tuning line="4"><tuning-step>G</tuning-step><tuning-octave>3</tuning-octave></staff-tuning>
<staff-tuning line="5"><tuning-step>B</tuning-step><tuning-octave>3</tuning-octave></staff-tuning>
<staff-tuning line="6"><tuning-step>E</tuning-step><tuning-octave>4</tuning-octave></staff-tuning>
</staff-details></attributes>
<direction><direction-type><metronome><beat-unit>quarter</beat-unit><per-minute>60</per-minute></metronome>
</direction-type></direction><barline location="left"><repeat direction="forward"/></barline>
NOTES
<barline location="right"><repeat direction="backward"/></barline></measure></part></score-partwise>"""


def note(step: str, octave: int, duration: int, technical: str = "", more: str = "", before: str = "") -> str:
    """A note of MusicXML, its duration in sixteenths."""
    inside = f"<notations><technical>{technical}</technical>{more}</notations>"
    pitch = f"<pitch><step>{step}</step><octave>{octave}</octave></pitch>"
    return f"<note>{before}{pitch}<duration>{duration}</duration>{inside}</note>"


def musicxml(notes: str) -> str:
    return MUSICXML.replace("NOTES", notes)


def mxl(path: Path, text: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        container = '<container><rootfiles><rootfile full-path="score.xml"/></rootfiles></container>'
        archive.writestr("META-INF/container.xml", container)
        archive.writestr("score.xml", text)
    return path


def guitar_pro(path: Path, change: Any = None, tempo: int = 60) -> Path:
    """A file of Guitar Pro 3, 4 or 5: four quarters on strings 6, 5, 4 and 3 at frets 0, 2, 5 and 7."""
    import guitarpro as gp

    song = gp.Song(title="Study", tempo=tempo)
    voice = song.tracks[0].measures[0].voices[0]
    for string, fret in ((6, 0), (5, 2), (4, 5), (3, 7)):
        beat = gp.Beat(voice, status=gp.BeatStatus.normal)
        beat.notes.append(gp.Note(beat, value=fret, string=string, type=gp.NoteType.normal))
        voice.beats.append(beat)
    if change is not None:
        change(song, voice.beats)
    gp.write(song, str(path))
    return path


GPIF = """<?xml version="1.0" encoding="utf-8"?><GPIF><Score><Title><![CDATA[Study]]></Title></Score>
<MasterTrack><Automations><Automation><Type>Tempo</Type><Bar>0</Bar><Position>0</Position><Value>60 2</Value>
</Automation></Automations></MasterTrack>
<Tracks><Track id="0"><Name>Guitar</Name><Staves><Staff><Properties><Property name="Tuning"><Pitches>40 45 50 55 59 64
</Pitches></Property><Property name="CapoFret"><Fret>CAPO</Fret></Property></Properties></Staff></Staves></Track>
</Tracks>
<MasterBars><MasterBar><Time>4/4</Time><Bars>0</Bars></MasterBar></MasterBars>
<Bars><Bar id="0"><Voices>0 -1 -1 -1</Voices></Bar></Bars><Voices><Voice id="0"><Beats>BEATS</Beats></Voice></Voices>
<Beats>BEAT</Beats><Notes>NOTE</Notes>
<Rhythms><Rhythm id="0"><NoteValue>Quarter</NoteValue></Rhythm><Rhythm id="1"><NoteValue>Eighth</NoteValue>
<PrimaryTuplet num="3" den="2"/></Rhythm></Rhythms></GPIF>"""


def gpif(path: Path, notes: list[tuple[int, int, str, str]], rhythm: int = 0, capo: int = 0) -> Path:
    """A file of Guitar Pro 7: one note (string from 0, fret, properties, elements) a beat."""
    places = '<Property name="String"><String>{}</String></Property><Property name="Fret"><Fret>{}</Fret></Property>'
    beats = "".join(
        f'<Beat id="{i}"><Dynamic>F</Dynamic><Rhythm ref="{rhythm}"/><Notes>{i}</Notes></Beat>'
        for i in range(len(notes))
    )
    written = "".join(
        f'<Note id="{i}">{more}<Properties>{places.format(string, fret)}{own}</Properties></Note>'
        for i, (string, fret, own, more) in enumerate(notes)
    )
    text = GPIF.replace("BEATS", " ".join(map(str, range(len(notes))))).replace("BEAT", beats)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Content/score.gpif", text.replace("NOTE", written).replace("CAPO", str(capo)))
    return path


def enabled(name: str) -> str:
    return f'<Property name="{name}"><Enable/></Property>'


def gpx_system(score: bytes) -> bytes:
    """File system of Guitar Pro 6 with a score: a sector that describes it, and its own from the third on."""
    n = -(-len(score) // 0x1000)
    entry = bytearray(0x1000)
    struct.pack_into("<i127s", entry, 0, 2, b"score.gpif")
    struct.pack_into("<i", entry, 0x8C, len(score))
    struct.pack_into(f"<{n + 1}i", entry, 0x94, *range(2, n + 2), 0)
    return b"BCFS" + bytes(0x1000) + bytes(entry) + score.ljust(n * 0x1000, b"\0")


def gpx_bits(*parts: bytes | tuple[int, int]) -> bytes:
    """Bits of a compressed file: bytes as they are, (back, size) as references of 15 bits."""
    bits = ""
    for part in parts:
        if isinstance(part, bytes):
            for i in range(0, len(part), 3):
                piece = part[i : i + 3]
                bits += "0" + f"{len(piece):02b}"[::-1] + "".join(f"{b:08b}" for b in piece)
        else:
            bits += "1" + "1111" + "".join(f"{n:015b}"[::-1] for n in part)
    return bytes(int(bits[i : i + 8].ljust(8, "0"), 2) for i in range(0, len(bits), 8))
