"""Compare Guitar Pro files with the notes that alphaTab plays of them, and print a table.

python scripts/guitar_pro_comparison.py FOLDER [--table]

FOLDER has the files and for each a FILE.notes.json with `notes`, a list of [onset in s, pitch, channel, ...], as
alphaTab's own MIDI generator writes them (`npm install @coderline/alphatab`). Notes on channel 10 (9 from 0) are drums,
which are counted here and not played. Two agree that play the same pitches as often and begin their last note within
0.03 s. Exit code 1 if a file differs that is not in `OTHERWISE`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import tonewood as tw

LATEST = 0.03
#: files that are played otherwise, and why
OTHERWISE = {
    "Demo v5.gp5": (
        "harmonics tapped 12 frets beyond the stop are of the octave, alphaTab takes the fret for the node; "
        "tremolo in sixteenths as written, alphaTab plays eighths of a half note"
    ),
    "Harmonics.gp5": "a harmonic tapped at fret 15 over fret 3 is of the octave, alphaTab takes fret 15 for the node",
}


@dataclass(frozen=True)
class Row:
    """One file: notes and last onset (s) here and by alphaTab."""

    name: str
    ours: int
    theirs: int
    last: float
    their_last: float
    same: bool


def rows(folder: Path) -> Iterator[Row]:
    """Compare all files of a folder."""
    for answers in sorted(folder.glob("*.notes.json")):
        name = answers.name.removesuffix(".notes.json")
        theirs = [n for n in json.loads(answers.read_text(encoding="utf-8"))["notes"] if n[2] != 9]
        ours = tw.read_score(folder / name).notes
        last, their_last = max((n.time for n in ours), default=0.0), max((n[0] for n in theirs), default=0.0)
        same = Counter(n.note for n in ours) == Counter(float(n[1]) for n in theirs)
        yield Row(name, len(ours), len(theirs), last, their_last, same and abs(last - their_last) <= LATEST)


def main() -> int:
    """Print the table, or the files that differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--table", action="store_true", help="print all files as a table of Markdown")
    arguments = parser.parse_args()
    began = time.perf_counter()
    found = list(rows(arguments.folder))
    seconds = time.perf_counter() - began
    if arguments.table:
        print("| file | notes | alphaTab | last, s | alphaTab | why |\n|---|---|---|---|---|---|")
        for r in found:
            why = "" if r.same else OTHERWISE.get(r.name, "?")
            print(f"| {r.name} | {r.ours} | {r.theirs} | {r.last:.2f} | {r.their_last:.2f} | {why} |")
    unexplained = [r for r in found if not r.same and r.name not in OTHERWISE]
    for r in unexplained:
        print(f"{r.name}: {r.ours} notes, alphaTab {r.theirs}; last at {r.last:.3f} s, alphaTab {r.their_last:.3f} s")
    if not arguments.table:
        print(f"{len(found)} files in {seconds:.1f} s, {sum(not r.same for r in found)} differ")
    return 1 if unexplained else 0


if __name__ == "__main__":
    raise SystemExit(main())
