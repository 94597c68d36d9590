"""Compare MusicXML files with the notes that music21 reads of them, and print those that differ with their kinds.

python scripts/musicxml_comparison.py FOLDER_OR_FILE ... [--seconds 60]

Pitches, onsets and durations in quarter notes, repeats unfolded and ties joined; `pip install music21`. Without a path
all MusicXML files that come with music21 are compared. A file that music21 takes longer for than `--seconds` is named.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import signal
import sys
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import tonewood as tw

sys.path.remove(str(Path(__file__).parent))  # its statistics.py would be taken for Python's by music21

#: quarter notes within which onsets and durations agree
NEAR = 1 / 16
Notes = list[tuple[float, float, float]]


def theirs(path: Path) -> Notes:
    """(onset, duration, pitch) of music21's notes, sorted."""
    import music21

    out: Notes = []
    score = music21.converter.parse(path, forceSource=True)
    if not isinstance(score, music21.stream.Score):  # an opus: its first score
        score = score.scores[0] if score.scores else score
    for part in score.parts:
        sounding = part
        with contextlib.suppress(music21.repeat.ExpanderException):
            sounding = part.expandRepeats()
        if sounding.atSoundingPitch is not True:
            sounding = sounding.toSoundingPitch()
        for note in sounding.stripTies().flatten().notes:
            other = (music21.harmony.ChordSymbol, music21.percussion.PercussionChord, music21.note.Unpitched)
            if not isinstance(note, other):
                out += [(float(note.offset), float(note.quarterLength), round(p.ps, 2)) for p in note.pitches]
    return sorted(out)


def ours(path: Path) -> Notes:
    """(onset, duration, pitch) of our notes, sorted."""
    score = tw.read_score(path)
    times = [(score.beats.quarter(n.time + 1e-9), score.beats.quarter(n.time + n.duration - 1e-9)) for n in score.notes]
    return sorted(
        (at, end - at, round(float(n.note or 0.0), 2)) for n, (at, end) in zip(score.notes, times, strict=True)
    )


def matched(a: Notes, b: Notes) -> tuple[list[tuple[float, float, float]], Notes, Notes]:
    """Differences of (pitch's onset, duration) of notes of both, and those of one alone, in order of time by pitch."""
    by_pitch: dict[float, list[list[tuple[float, float]]]] = {}
    for k, notes in enumerate((a, b)):
        for at, length, pitch in notes:
            by_pitch.setdefault(pitch, [[], []])[k].append((at, length))
    both: list[tuple[float, float, float]] = []
    alone: tuple[Notes, Notes] = ([], [])
    for pitch, (mine, other) in by_pitch.items():
        i = j = 0
        while i < len(mine) and j < len(other):
            late = mine[i][0] - other[j][0]
            if abs(late) <= NEAR or len(mine) == len(other):
                both.append((late, mine[i][1] - other[j][1], mine[i][0]))
                i, j = i + 1, j + 1
            elif late < 0:
                alone[0].append((*mine[i], pitch))
                i += 1
            else:
                alone[1].append((*other[j], pitch))
                j += 1
        alone[0].extend((*x, pitch) for x in mine[i:])
        alone[1].extend((*x, pitch) for x in other[j:])
    return both, *alone


def signs(path: Path) -> Counter[str]:
    """How often a file has elements that are read otherwise."""
    data = path.read_bytes()
    if path.suffix == ".mxl":
        with zipfile.ZipFile(path) as archive:
            data = b"".join(archive.read(n) for n in archive.namelist() if n.endswith("xml") and "META" not in n)
    names = (
        "grace", "cue", "tremolo", "trill-mark", "turn", "inverted-turn", "mordent", "inverted-mordent", "schleifer",
        "staccato", "staccatissimo", "fermata", "arpeggiate", "pedal", "unpitched", "transpose", "octave-shift",
        "repeat", "ending", "swing", "segno", "coda", "sound", "tied", "rehearsal", "wavy-line",
    )  # fmt: skip
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8", "replace")
    found = Counter(re.findall(r"<([a-z-]+)[ />]", text))
    return Counter({name: found[name] for name in names if found[name]})


def files(paths: list[Path]) -> Iterator[Path]:
    """MusicXML files of folders."""
    for path in paths:
        yield from (
            sorted(p for p in path.rglob("*") if p.suffix in (".xml", ".mxl", ".musicxml")) if path.is_dir() else [path]
        )


def main() -> int:
    """Print files that differ, and how many agree."""
    import music21

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", type=Path, nargs="*", default=[Path(music21.__file__).parent])
    parser.add_argument("--seconds", type=int, default=60)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    count: Counter[str] = Counter()

    def late(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, late)
    for path in files(arguments.paths):
        signal.alarm(arguments.seconds)
        try:
            b = theirs(path)
            signal.alarm(0)
            a = ours(path)
        except (Exception, TimeoutError) as error:
            signal.alarm(0)
            count["refused"] += 1
            print(f"{path.name}: {type(error).__name__} {error}"[:200], flush=True)
            continue
        both, mine, other = matched(a, b)
        onsets = [x for x in both if abs(x[0]) > NEAR]
        lengths = [x for x in both if abs(x[1]) > NEAR]
        kinds = [k for k, v in (("pitches", mine or other), ("onsets", onsets), ("durations", lengths)) if v]
        count["files"] += 1
        count[" ".join(kinds) or "agree"] += 1
        if kinds:
            examples = [tuple(round(v, 3) for v in x) for x in (*mine[:2], *other[:2], *onsets[:1], *lengths[:2])]
            print(
                f"{path.name}: {', '.join(kinds)}; {len(a)} notes, {len(b)}; alone {len(mine)}, {len(other)}; "
                f"{len(onsets)} onsets, {len(lengths)} durations; {dict(signs(path))} {examples}",
                flush=True,
            )
    print(dict(count))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
