"""Results as one HTML page without network; every text is escaped."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

from tonewood.support.page.offline import offline_page
from tonewood.support.plotting import data_uri, png
from tonewood.support.whole_files import write_whole
from tonewood.workshop.listening.figures import figures_of
from tonewood.workshop.listening.plain import methods, summary
from tonewood.workshop.listening.results import PanelResults


def write_report(panel: PanelResults, folder: Path, facts: dict[str, Any] | None = None) -> Path:
    """Write ``report.html``, and its figures as PNG beside it.

    facts : of the stimuli, as ``manifest.json`` has them; None leaves that section out.
    Raises TonewoodError : jinja2 or matplotlib is not installed.
    """
    pictures: dict[int, list[tuple[str, str]]] = {}
    for number, page in enumerate(panel.pages):
        for name, picture in figures_of(panel, page).items():
            content = png(picture, dpi=75)
            path = folder / f"page{page.page}_{number}_{name}.png"
            path.write_bytes(content)
            pictures.setdefault(number, []).append((name, data_uri(content, "image/png")))
    static = files("tonewood.workshop.listening") / "static"
    text = offline_page(
        (static / "report.html").read_text("utf-8"),
        {"p": p_text, "g": lambda x: f"{x:.3g}"},
        panel=panel,
        title=panel.test.title(panel.test.manifest.language),
        pictures=pictures,
        facts=facts,
        summary=summary(panel),
        methods=methods(panel),
        page_style=(static / "report.css").read_text("utf-8"),
    )
    write_whole(folder / "report.html", text)
    return folder / "report.html"


def p_text(value: float | None) -> str:
    """A probability: three decimals, or a bound."""
    if value is None:
        return "\N{EN DASH}"
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
