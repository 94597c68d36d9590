"""A template as one HTML page without network: style and script are in the file.

The page's content security policy allows nothing else: no connection, no other script than this one (by its SHA-256).
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from tonewood import __version__
from tonewood.errors import TonewoodError
from tonewood.support.plotting import COLOURS


def offline_page(template: str, filters: Mapping[str, Callable[..., str]] = MappingProxyType({}), **values: Any) -> str:
    """Fill a Jinja template with values; every text among them is escaped.

    The template finds ``version``, ``colours``, the macros of ``parts`` (among them ``head`` and ``foot`` of a page),
    and the filters ``fixed`` (digits, signed) and ``shown``.

    filters : further ones, by name.
    Raises TonewoodError : jinja2 is not installed.
    """
    try:
        from jinja2 import DictLoader, Environment, StrictUndefined
        from markupsafe import Markup
    except ImportError:
        raise TonewoodError("pages need jinja2: pip install 'tonewood[report]'") from None
    folder = files("tonewood.support.page")
    style, script, parts = (
        (folder / name).read_text(encoding="utf-8") for name in ("page.css", "player.js", "parts.html")
    )
    environment = Environment(autoescape=True, undefined=StrictUndefined, loader=DictLoader({"parts": parts}))
    environment.filters |= {"fixed": fixed, "shown": _shown} | dict(filters)
    common = {
        "version": __version__,
        "colours": COLOURS,
        "style": Markup(style),
        "script": Markup(script),
        "script_hash": f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}",
    }
    return environment.from_string(template).render(**common, **values)


def fixed(value: float | None, digits: int, signed: bool = False) -> str:
    """A number with so many decimals, a true minus sign, infinity as a sign; 0 without a sign; a dash for none."""
    if value is None or math.isnan(value):
        return "\N{EN DASH}"
    if not math.isfinite(value):
        return "\N{INFINITY}" if value > 0 else "\N{MINUS SIGN}\N{INFINITY}"
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    if not float(text):
        text = text.lstrip("+-")
    return text.replace("-", "\N{MINUS SIGN}")


def _shown(value: Any) -> str:
    """A value of a bundle as it would stand in its file."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
