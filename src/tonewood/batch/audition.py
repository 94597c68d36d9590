"""A plain page to hear everything of a batch, with pictures: one HTML file, relative links, no script."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from tonewood.batch.layout import Group
from tonewood.batch.manifest import Manifest
from tonewood.batch.pages import localised
from tonewood.batch.pictures import CAPTION, HEIGHT, WIDTH
from tonewood.batch.production import PICTURES, SoundFile
from tonewood.whole_files import whole_file

FILE = "audition.html"

_HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font-family: system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; padding: 0 1rem; color: #222; }}
section {{ border-top: 1px solid #ccc; margin-top: 2rem; }}
figure {{ margin: 1rem 0; }}
figcaption {{ display: flex; flex-wrap: wrap; gap: 1rem; align-items: center; }}
img {{ display: block; max-width: 100%; height: auto; }}
.facts {{ color: #666; font-size: .85rem; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p class="facts">{count} sounds. {caption}</p>
"""


def audition_page(manifest: Manifest, groups: Sequence[Group], files: dict[str, SoundFile]) -> str:
    """The page as text; a blind batch shows codes where an open one shows conditions."""
    title = escape(localised(manifest.title, manifest.language) or manifest.name)
    parts = [_HEAD.format(title=title, count=len(files), caption=CAPTION)]
    for number, group in enumerate(groups, start=1):
        shown = [files[s.code] for s in group.stimuli if s.code in files]
        if not shown:
            continue
        question = escape(localised(manifest.pages[group.page].name, manifest.language))
        name = f"Set {number}" if manifest.output.blind else escape(group.name)
        parts.append(f"<section>\n<h2>{name}</h2>\n" + (f"<p>{question}</p>\n" if question else ""))
        parts += [_sound(manifest, file) for file in shown]
        parts.append("</section>\n")
    parts.append("</body>\n</html>\n")
    return "".join(parts)


def write_audition(folder: Path, page: str) -> None:
    """Write the page into the batch's folder."""
    with whole_file(folder / FILE, make_folder=True) as stream:
        stream.write(page.encode())


def _sound(manifest: Manifest, file: SoundFile) -> str:
    if manifest.output.blind:
        name = file.code
    else:
        name = escape(file.condition) + (f" ({file.role})" if file.role != "sound" else "")
    loudness = "" if file.lufs is None else f"{file.lufs:.1f} LUFS{'' if file.loudness_gated else ' (ungated)'}, "
    peak = "silent" if file.true_peak_dbtp is None else f"{file.true_peak_dbtp:.1f} dBTP"
    facts = f"{file.frames / file.fs:.2f} s, {loudness}{peak}"
    return (
        f'<figure id="{file.code}">\n<figcaption><strong>{name}</strong> '
        f'<audio controls preload="metadata" src="{file.file}"></audio> '
        f'<span class="facts">{facts}</span></figcaption>\n'
        f'<img src="{PICTURES}/{file.code}.png" width="{WIDTH}" height="{HEIGHT}" loading="lazy" '
        f'alt="waveform and spectrogram of {name}">\n</figure>\n'
    )
