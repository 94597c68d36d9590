"""The MusicXML test suite that comes with music21, read here and by music21: the same pitches, as often."""

from __future__ import annotations

import contextlib
from collections import Counter
from pathlib import Path

import pytest

import tonewood as tw

#: files that are read otherwise, and why
OTHERWISE = {
    "02e-Rests-NoType.xml": "music21 counts a note without a staff twice",
    "23e-Tuplets-Tremolo.xml": "tremolos are played here",
    "32aa-Notations2_Ornaments.xml": "ornaments are played here",
    "32c-MultipleNotationChildren.xml": "the pitch counts here, the accidental there",
    "33a-Spanners.xml": "trills are played here",
    "33f-Trill-EndingOnGraceNote.xml": "trills are played here",
    "33i-Ties-NotEnded.xml": "a tie that does not end",
}


@pytest.mark.validate
@pytest.mark.filterwarnings("ignore")
def test_the_suite_is_read_as_by_music21() -> None:
    music21 = pytest.importorskip("music21")
    folder = Path(music21.__file__).parent / "musicxml" / "lilypondTestSuite"
    files = sorted(p for p in folder.iterdir() if p.suffix in (".xml", ".mxl"))
    assert len(files) > 100
    differ = []
    for path in files:
        wanted: Counter[float] = Counter()
        for part in music21.converter.parse(path, forceSource=True).parts:
            sounding = part
            with contextlib.suppress(music21.repeat.ExpanderException):
                sounding = part.expandRepeats()
            if sounding.atSoundingPitch is not True:
                sounding = sounding.toSoundingPitch()
            for note in sounding.stripTies().recurse().notes:
                unpitched = (music21.harmony.ChordSymbol, music21.percussion.PercussionChord, music21.note.Unpitched)
                if not isinstance(note, unpitched):
                    wanted.update(round(p.ps, 2) for p in note.pitches)
        if Counter(round(float(n.note or 0.0), 2) for n in tw.read_score(path).notes) != wanted:
            differ.append(path.name)
    assert set(differ) <= set(OTHERWISE)
