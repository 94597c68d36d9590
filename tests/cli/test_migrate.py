"""``tonewood migrate``: bundles and manifests of version 0.1 become those of this version."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import BundleError, OldFormatWarning
from tonewood.instrument.bundle.schema import SCHEMA
from tonewood.workshop.batch.manifest import ManifestError, load_manifest

ROOT = Path(__file__).parents[2]
OLD = "tonewood-instrument/1"
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def migrate(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: object, command: str = "migrate") -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            run([command, *map(str, arguments)])
        out, err = capsys.readouterr()
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, out, err

    return call


def old_bundle(folder: Path, name: str = "monochord") -> Path:
    """A built-in bundle as version 0.1 had it."""
    shutil.copytree(ROOT / "instruments" / name, folder)
    file = folder / "instrument.yaml"
    text = file.read_bytes()
    assert text.count(SCHEMA.encode()) == 1
    file.write_bytes(text.replace(SCHEMA.encode(), OLD.encode()))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(p.parent.name for p in (ROOT / "instruments").glob("*/instrument.yaml")))
def test_every_built_in_bundle_comes_back_byte_for_byte(tmp_path: Path, migrate: Run, name: str) -> None:
    folder = old_bundle(tmp_path / "old", name)
    file = folder / "instrument.yaml"
    before = file.read_bytes()
    assert migrate("--check", folder)[:2] == (
        1,
        f"{file}: would be rewritten: schema: tonewood-instrument/1 becomes tonewood-instrument/2\n",
    )
    assert file.read_bytes() == before
    assert migrate(folder)[:2] == (
        0,
        f"{file}: rewritten: schema: tonewood-instrument/1 becomes tonewood-instrument/2\n",
    )
    assert file.read_bytes() == (ROOT / "instruments" / name / "instrument.yaml").read_bytes()
    assert migrate(file)[:2] == (0, f"{file}: up to date\n")
    assert migrate("--check", folder)[0] == 0
    assert sorted(p.name for p in folder.iterdir()) == sorted(os.listdir(ROOT / "instruments" / name))


def test_an_old_bundle_loads_with_a_note(tmp_path: Path, migrate: Run) -> None:
    folder = old_bundle(tmp_path / "old")
    with pytest.warns(OldFormatWarning, match=rf"schema: {OLD} is deprecated; run: tonewood migrate {folder}$"):
        loaded = tw.load_instrument(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert loaded.resolved == tw.load_instrument("monochord").resolved
        loaded.replace({"tuning.reference_freq": 442.0})
    code, _, err = migrate(folder, command="modes")
    assert code == 0
    line = f"{folder}/instrument.yaml: schema: {OLD} is deprecated; run: tonewood migrate {folder}"
    assert err == f"tonewood: warning: {line}\n"


def test_a_later_schema_is_refused(tmp_path: Path, migrate: Run) -> None:
    folder = old_bundle(tmp_path / "new")
    file = folder / "instrument.yaml"
    file.write_bytes(file.read_bytes().replace(OLD.encode(), b"tonewood-instrument/3"))
    reason = f"tonewood-instrument/3 is of a later version of tonewood; this one reads {SCHEMA}: upgrade tonewood"
    line = f"{file}: line {1 + file.read_text().splitlines().index('schema: tonewood-instrument/3')}: schema: {reason}"
    for command in ("migrate", "modes"):
        assert migrate(folder, command=command) == (2, "", f"tonewood: {line}\n")
    with pytest.raises(BundleError, match="upgrade tonewood"):
        tw.load_instrument(folder)


def manifest(tmp_path: Path, change: str, to: str) -> Path:
    shutil.copytree(ROOT / "examples" / "listening_test", tmp_path / "test")
    file = tmp_path / "test" / "harp_damping.yaml"
    text = file.read_text(encoding="utf-8")
    assert change in text
    file.write_text(text.replace(change, to, 1), encoding="utf-8")
    return file


def test_precision_is_taken_out_of_a_manifest(tmp_path: Path, migrate: Run) -> None:
    new = (ROOT / "examples" / "listening_test" / "harp_damping.yaml").read_text(encoding="utf-8")
    file = manifest(tmp_path, "fs: 48000,", "fs: 48000, precision: f32,")
    with pytest.raises(ManifestError, match=r"render\.precision: was removed in 0\.2.*`tonewood migrate`"):
        load_manifest(file)
    done = "render.precision (f32) is removed: always double"
    assert migrate("--check", file)[:2] == (1, f"{file}: would be rewritten: {done}\n")
    assert migrate(file)[:2] == (0, f"{file}: rewritten: {done}\n")
    assert file.read_text(encoding="utf-8") == new
    assert migrate(file)[:2] == (0, f"{file}: up to date\n")
    load_manifest(file)


def test_a_factor_of_precision_is_left_to_its_author(tmp_path: Path, migrate: Run) -> None:
    file = manifest(tmp_path, "\nfactors:\n", "\nfactors:\n  p: {path: render.precision, levels: {a: f32, b: f64}}\n")
    before = file.read_bytes()
    code, out, err = migrate(file)
    assert (code, out) == (2, "")
    line = 1 + next(i for i, text in enumerate(file.read_text().splitlines()) if text.startswith("  p: "))
    assert err.startswith(
        f"tonewood: {file}: line {line}: factors.p: varies render.precision, which was removed in 0.2"
    )
    assert err.count("\n") == 1
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "cannot be read: No such file"),
        (b"schema: tonewood-key/1\n", "schema: neither a bundle (tonewood-instrument/N) nor a batch manifest"),
        (b"name: x\n", "schema: neither a bundle"),
        (b"schema: [1\n", "line 2:"),
        (b"\xff\n", "byte 0 (line 1) is not UTF-8"),
    ],
)
def test_other_files_are_one_line_and_nothing_is_written(
    tmp_path: Path, migrate: Run, content: bytes | None, reason: str
) -> None:
    folder, file = old_bundle(tmp_path / "old"), tmp_path / "x.yaml"
    if content is not None:
        file.write_bytes(content)
    code, out, err = migrate(folder, file)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{file}: " in err
    assert reason in err
    assert OLD in (folder / "instrument.yaml").read_text(encoding="utf-8")


def test_a_file_that_cannot_be_replaced_stays_whole(tmp_path: Path, migrate: Run, monkeypatch: Any) -> None:
    folder = old_bundle(tmp_path / "old")
    before = (folder / "instrument.yaml").read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tonewood.support.whole_files.os.replace", full)
    code, _, err = migrate(folder)
    assert (code, err.count("\n")) == (2, 1)
    assert "No space left on device" in err
    assert (folder / "instrument.yaml").read_bytes() == before
    assert sorted(p.name for p in folder.iterdir()) == sorted(os.listdir(ROOT / "instruments" / "monochord"))
