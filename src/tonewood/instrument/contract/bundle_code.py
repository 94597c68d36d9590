"""Plugins that lie as Python files in a bundle's folder, ``plugin: FILE.py:CLASS``; they run only if that is allowed.

A bundle is data: loading it runs no code of its maker. One that names a file is refused unless the person who loads it
allows its code. The file is compiled from the very bytes whose hash is recorded, and leaves no ``__pycache__`` behind.
"""

from __future__ import annotations

import hashlib
import re
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from tonewood.errors import BundleError, PluginError, words_of
from tonewood.instrument.contract import registry
from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import check_kind, check_plugin

#: FILE.py:CLASS as a regular expression
CODE_PATTERN = r"[^:]+\.py:[A-Za-z_]\w*"


def is_code(name: str) -> bool:
    """Whether a bundle's word after ``plugin:`` names a file instead of an installed plugin."""
    return re.fullmatch(CODE_PATTERN, name) is not None


def plugin_named(name: str, kind: str, files: Files) -> type[Plugin[Any]]:
    """Class of a plugin that a bundle names: an installed one, or one in the bundle's folder.

    name : of its entry point, or ``FILE.py:CLASS``, the file relative to the folder.
    kind : that is wanted.
    files : the folder.
    Raises PluginError : there is none; it breaks the contract; it is code, and that is not allowed.
    """
    return _code_plugin(name, kind, files) if is_code(name) else registry.plugin(name, kind)


def _code_plugin(name: str, kind: str, files: Files) -> type[Plugin[Any]]:
    """Class of a plugin in a bundle's folder.

    name : ``FILE.py:CLASS``, the file relative to the folder.
    kind : that is wanted.
    files : the folder, and whether its code may run.
    Raises PluginError : code is not allowed; the file is not in the folder or cannot be run, or the class breaks the
        contract.
    """
    file, _, cls = name.rpartition(":")
    if not files.allow_code:
        raise PluginError(
            f"the bundle holds code, {file}, which could do anything that you can do; to run it, give --allow-code on "
            "the command line, or allow_code=True in Python"
        )
    try:
        path = files.path(file)
        module = _module(path, hashlib.sha256(path.read_bytes()).hexdigest())
    except BundleError as fault:
        raise PluginError(fault.reason) from None
    except (Exception, SystemExit) as fault:  # code of a third party may raise anything
        raise PluginError(f"{file} cannot be run: {words_of(fault)}") from None
    if not hasattr(module, cls):
        raise PluginError(f"{file} has no class {cls}")
    plugin: type[Plugin[Any]] = getattr(module, cls)
    check_plugin(plugin, f"plugin {name!r}")
    check_kind(plugin, name, kind)
    return plugin


def code_hash(plugin: type[Plugin[Any]]) -> str:
    """SHA-256 of the file that the class of `code_plugin` was made from, as it was when it was run."""
    return str(vars(sys.modules[plugin.__module__])["_SHA256"])


@cache
def _module(path: Path, sha256: str) -> ModuleType:
    """Module of a file with this hash; another one as soon as the file changes."""
    source = path.read_bytes()
    if hashlib.sha256(source).hexdigest() != sha256:
        raise OSError("it is being changed")
    module = ModuleType(f"_tonewood_{path.stem}_{hashlib.sha256(f'{path}{sha256}'.encode()).hexdigest()[:16]}")
    module.__file__ = str(path)
    vars(module)["_SHA256"] = sha256
    code = compile(source, str(path), "exec")
    # pydantic resolves the annotations of a class in its module
    sys.modules[module.__name__] = module
    try:
        exec(code, vars(module))
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module
