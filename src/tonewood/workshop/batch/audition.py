"""A page to hear everything of a batch: gapless switching, one cursor, sorting by factor, names hidden until asked for.

``audition.html`` opens from the disk. Sounds of a set are in ``audition/setN.js``, loaded when it is first played:
browsers let a page from the disk load scripts, but neither sounds for gapless playing nor data. Names of conditions
are in ``audition/names.js``, which is loaded when the page is unblinded. Texts are set as text by the script.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.conditions import Condition
from tonewood.workshop.batch.layout import Group
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import localised
from tonewood.workshop.batch.pictures import CAPTION
from tonewood.workshop.batch.production import PICTURES, SoundFile

FILE = "audition.html"
FOLDER = "audition"
NO_PICTURES = "Below each sound its course in time; `pictures: true` under `output` draws waveforms and spectrograms."


def write_audition(
    folder: Path,
    manifest: Manifest,
    groups: Sequence[Group],
    files: Mapping[str, SoundFile],
    conditions: Mapping[str, Condition],
) -> None:
    """Write the page, its sounds and its names into the batch's folder; files of an earlier run are removed."""
    language = manifest.language
    shown = [g for g in groups if any(s.code in files for s in g.stimuli)]
    sets: list[dict[str, Any]] = []
    names: dict[str, Any] = {}
    for number, group in enumerate(shown, start=1):
        present = [s for s in group.stimuli if s.code in files]
        sets.append(
            {
                "title": f"Set {number}",
                "question": localised(manifest.pages[group.page].name, language),
                "sounds": [{"code": s.code, "facts": facts_of(files[s.code])} for s in present],
                "script": f"{FOLDER}/set{number}.js",
                "figure": f"{PICTURES}/differences{number}.png",
            }
        )
        names[f"Set {number}"] = group.name
        for stimulus in present:
            levels = conditions[stimulus.condition].all_levels
            names[stimulus.code] = {"name": stimulus.condition, "role": stimulus.role, "levels": levels}
        sounds = {s.code: base64.b64encode((folder / files[s.code].file).read_bytes()).decode() for s in present}
        write_whole(
            folder / FOLDER / f"set{number}.js", f"soundsOf({number - 1}, {_json(sounds)});\n", make_folder=True
        )
    for path in (folder / FOLDER).glob("set*.js"):
        if path.stem.removeprefix("set").isdecimal() and int(path.stem.removeprefix("set")) > len(sets):
            path.unlink()
    factors = [name for name, levels in manifest.choices().items() if len(levels) > 1]
    factors += ["repeat"] if manifest.repeats > 1 else []
    revealed = _json({"factors": factors, "names": names})
    write_whole(folder / FOLDER / "names.js", f"namesAre({revealed});\n", make_folder=True)
    title = localised(manifest.title, language) or manifest.name
    data = {"sets": sets, "blind": manifest.output.blind, "pictures": PICTURES if manifest.output.pictures else ""}
    assets = package_files("tonewood.workshop.batch")
    page, script = ((assets / f"audition.{kind}").read_text("utf-8") for kind in ("html", "js"))
    caption = CAPTION if manifest.output.pictures else NO_PICTURES
    for mark, text in (
        ("{{title}}", escape(title)), ("{{caption}}", escape(caption)), ("{{count}}", str(len(files))),
        ("{{data}}", _json(data)), ("{{script}}", script),
    ):  # fmt: skip
        page = page.replace(mark, text)
    write_whole(folder / FILE, page, make_folder=True)


def facts_of(file: SoundFile) -> str:
    """Length and levels of a file in words."""
    loudness = "" if file.lufs is None else f"{file.lufs:.1f} LUFS{'' if file.loudness_gated else ' (ungated)'}, "
    peak = "silent" if file.true_peak_dbtp is None else f"{file.true_peak_dbtp:.1f} dBTP"
    return f"{file.frames / file.fs:.2f} s, {loudness}{peak}"


def _json(data: Any) -> str:
    """JSON that may stand in a script element of a page."""
    text = json.dumps(data, ensure_ascii=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
