"""Files kept between runs: only the content written under a key is read, and only in a folder of the user's own."""

from __future__ import annotations

import io
import json
import os
import pickle
import random
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tonewood.errors import CacheFolderWarning, DamagedCacheWarning
from tonewood.instrument.contract import array_cache
from tonewood.support import cache_folder
from tonewood.support.cache_folder import keep, read_kept
from tonewood.support.yaml_io import load_yaml

KEY, OTHER_KEY = "0123456789abcdef" * 4, "0123456789abcdef" * 3 + "f" * 16
pytestmark = pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path / "kept"))
    array_cache._RECENT.clear()
    yield tmp_path / "kept"
    array_cache._RECENT.clear()


def read(key: str = KEY, kind: str = "words") -> bytes | None:
    return read_kept(kind, key, bytes)


def arrays() -> dict[str, np.ndarray]:
    return {"a": np.arange(40.0) ** 0.5, "b": np.eye(5)}


def again() -> dict[str, np.ndarray]:
    """As a new process would."""
    array_cache._RECENT.clear()
    return array_cache.cached_arrays({"x": 1}, arrays)


@pytest.mark.parametrize("word", ["off", "OFF", " off "])
def test_off_keeps_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str) -> None:
    """However it is written: no folder of that name appears."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TONEWOOD_CACHE", word)
    keep("words", KEY, b"line")
    assert read() is None
    assert list(tmp_path.iterdir()) == []


def test_what_is_kept_is_read_and_the_folder_is_private(folder: Path) -> None:
    assert read() is None
    keep("words", KEY, b"line\nand more")
    assert read() == b"line\nand more"
    assert folder.stat().st_mode & 0o777 == 0o700
    keep("words", KEY, b"")
    assert read() == b""


def test_a_folder_below_one_that_is_not_there_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path / "a" / "b" / "cache"))
    keep("words", KEY, b"kept")
    assert read() == b"kept"


def test_every_damaged_byte_is_noticed_and_the_file_is_written_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any byte changed, any length cut: the arrays are computed again, with one warning, and kept."""
    again()
    (file,) = folder.iterdir()
    monkeypatch.setattr(np, "savez_compressed", None)  # nothing is computed: it is read
    again()
    monkeypatch.undo()
    monkeypatch.setenv("TONEWOOD_CACHE", str(folder))
    whole, rng = file.read_bytes(), random.Random(1)
    damaged = [whole[:n] for n in (0, 1, 20, 90, 158, len(whole) // 2, len(whole) - 1)] + [whole + b"x", whole * 2]
    for _ in range(300):
        at, by = rng.randrange(len(whole)), rng.randrange(1, 256)
        damaged.append(whole[:at] + bytes([whole[at] ^ by]) + whole[at + 1 :])
    for content in damaged:
        file.write_bytes(content)
        with pytest.warns(DamagedCacheWarning, match=file.name) as caught:
            found = again()
        assert len(caught) == 1
        assert "\n" not in str(caught[0].message)
        assert found.keys() == arrays().keys()
        assert all(np.array_equal(found[k], a) for k, a in arrays().items())
        assert file.read_bytes() == whole
    assert list(folder.iterdir()) == [file]


def npz(**values: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.savez(out, **values)
    return out.getvalue()


def huge() -> bytes:
    """An archive whose array would take 728 TiB."""
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000000,), }".ljust(117) + "\n"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00v\x00" + header.encode())
    return out.getvalue()


class Command:
    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, ("touch unpickled",)


FOREIGN = {
    "others": npz(a=np.ones(1), b=np.eye(2)), "pickle in npz": npz(a=np.array([Command()])),
    "pickle": pickle.dumps(Command()), "huge": huge(), "json": b"{}",
}  # fmt: skip


@pytest.mark.parametrize("with_heading", [False, True])
@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_files_are_not_used(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, with_heading: bool
) -> None:
    """Nor unpickled. Under a heading with its right hash a pickle is not run, and a huge array not made."""
    monkeypatch.chdir(tmp_path)
    content = FOREIGN[name]
    again()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    if with_heading and name != "others":
        content = cache_folder._heading("arrays", whole.split()[2].decode(), content) + b"\n" + content
    file.write_bytes(content)
    with pytest.warns(DamagedCacheWarning, match="it is computed again"):
        assert np.array_equal(again()["a"], arrays()["a"])
    assert file.read_bytes() == whole
    assert not (tmp_path / "unpickled").exists()


def test_a_file_of_another_key_kind_or_version_is_not_read(folder: Path) -> None:
    keep("words", KEY, b"words")
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.rename(folder / f"{OTHER_KEY[:32]}.words")  # the names have the first 32 digits in common
    with pytest.warns(DamagedCacheWarning):
        assert read(OTHER_KEY) is None
    (folder / f"{KEY[:32]}.names").write_bytes(whole)
    with pytest.warns(DamagedCacheWarning):
        assert read(kind="names") is None
    file.write_bytes(whole.replace(b"tonewood-cache/1", b"tonewood-cache/0"))
    with pytest.warns(DamagedCacheWarning):
        assert read() is None
    file.write_bytes(whole)
    assert read() == b"words"


def test_nobody_changes_the_arrays_of_the_next_caller(folder: Path) -> None:
    """Neither those just computed, nor those read, nor by way of the maker's own, nor the table of names."""
    own = np.arange(3.0)
    for made in (array_cache.cached_arrays({"x": 2}, lambda: {"a": own, "b": np.eye(2)}), again(), again()):
        for array in made.values():
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0
        made.clear()
    own[:] = -1.0
    assert np.array_equal(array_cache.cached_arrays({"x": 1}, arrays)["a"], arrays()["a"])
    array_cache._RECENT.clear()
    first = array_cache.cached_arrays({"x": 3}, lambda: {"a": own})
    own[:] = 7.0
    assert first["a"].tolist() == [-1.0, -1.0, -1.0]


def test_functions_that_compute_something_else_of_the_same_inputs_have_files_of_their_own(folder: Path) -> None:
    def doubled() -> dict[str, np.ndarray]:
        return {"a": 2 * arrays()["a"]}

    assert np.array_equal(again()["a"], arrays()["a"])
    assert np.array_equal(array_cache.cached_arrays({"x": 1}, doubled)["a"], doubled()["a"])
    assert len(list(folder.iterdir())) == 2


def test_a_changed_source_file_of_the_function_is_another_content(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plugin that computes otherwise than its last version does not get that version's arrays."""
    source = folder.parent / "my_body.py"
    monkeypatch.syspath_prepend(str(folder.parent))
    for value in (1.0, 2.0):
        source.write_text(f"import numpy as np\ndef make():\n    return {{'a': np.array({value})}}\n")
        sys.modules.pop("my_body", None)
        exec(compile(source.read_text(), str(source), "exec"), namespace := {"__name__": "my_body"})
        sys.modules["my_body"] = type(sys)("my_body")
        sys.modules["my_body"].__file__ = str(source)
        array_cache._RECENT.clear()
        assert array_cache.cached_arrays({"x": 1}, namespace["make"])["a"] == value
    monkeypatch.delitem(sys.modules, "my_body")


def test_the_sources_that_compute_are_part_of_the_key(folder: Path) -> None:
    """A package that has moved would otherwise have no sources, and its arrays would outlive every change of it."""
    names = {"/".join(path.parts[-2:]) for path in array_cache._source_files("physics")}
    assert {"plate/plate.py", "plate/radiation.py", "modal/modes.py"} <= names
    with pytest.raises(ValueError, match="tonewood has no package 'plate'"):
        array_cache.cached_arrays({"x": 1}, arrays, package="plate")


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702, 0o1777])
def test_a_folder_that_others_may_write_to_is_not_used(folder: Path, mode: int) -> None:
    keep("words", KEY, b"words")
    folder.chmod(mode)
    with pytest.warns(CacheFolderWarning, match=r"can be written to by others .* TONEWOOD_CACHE") as caught:
        assert read() is None
    assert len(caught) == 1
    with pytest.warns(CacheFolderWarning):
        keep("words", OTHER_KEY, b"more")
    assert len(list(folder.iterdir())) == 1
    folder.chmod(0o755)
    assert read() == b"words"


def test_a_folder_or_a_file_of_another_user_is_not_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep("words", KEY, b"words")
    own = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    with pytest.warns(CacheFolderWarning, match="belongs to another user"):
        assert read() is None
    monkeypatch.setattr(cache_folder, "_is_own", lambda folder: True)
    with pytest.warns(DamagedCacheWarning, match="not the file of this name"):
        assert read() is None


def test_links_are_not_followed(folder: Path, tmp_path: Path) -> None:
    """Of a name in the folder; it is replaced and its target is left alone. The folder itself may be a link."""
    keep("words", KEY, b"words")
    (file,) = folder.iterdir()
    elsewhere = file.rename(tmp_path / "elsewhere")
    content = elsewhere.read_bytes()
    for target in (elsewhere, tmp_path / "nowhere", tmp_path):
        file.unlink(missing_ok=True)
        file.symlink_to(target)
        with pytest.warns(DamagedCacheWarning, match="a link"):
            assert read() is None
        keep("words", KEY, b"other words")
        assert read() == b"other words"
        assert not file.is_symlink()
    assert elsewhere.read_bytes() == content
    assert not (tmp_path / "nowhere").exists()
    folder.rename(tmp_path / "moved")
    folder.symlink_to(tmp_path / "moved")
    assert read() == b"other words"


def test_a_pipe_in_the_place_of_a_file_does_not_block(folder: Path) -> None:
    keep("words", KEY, b"words")
    (file,) = folder.iterdir()
    file.unlink()
    os.mkfifo(file)
    with pytest.warns(DamagedCacheWarning):
        assert read() is None
    keep("words", KEY, b"words")
    assert read() == b"words"


def test_without_a_place_to_write_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file in the folder's place, a name that no folder can have, a folder below a file."""
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file" / "below", tmp_path / ("n" * 300), Path("/proc/none/at/all")):
        monkeypatch.setenv("TONEWOOD_CACHE", str(place))
        keep("words", KEY, b"words")
        assert read() is None
        assert np.array_equal(again()["a"], arrays()["a"])
    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path / "file"))
    with pytest.warns(CacheFolderWarning, match="is no folder"):
        assert read() is None


FULL = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))  # as a full disk: writing fails half-way
from tonewood.support.cache_folder import keep, read_kept
keep("words", "0" * 64, b"x" * 10_000)
assert read_kept("words", "0" * 64, bytes) is None
"""


def test_a_full_disk_leaves_nothing(folder: Path) -> None:
    done = subprocess.run([sys.executable, "-c", FULL], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(folder.iterdir()) == []


WRITER = """
import sys
from tonewood.support.cache_folder import keep, read_kept
for i in range(150):
    keep("words", "0" * 64, bytes([i % 256]) * 20_000)
    got = read_kept("words", "0" * 64, bytes)
    assert got is not None and len(set(got)) == 1 and len(got) == 20_000
"""


def test_processes_that_write_at_once_read_whole_files(folder: Path) -> None:
    command = [sys.executable, "-W", "error", "-c", WRITER]
    writers = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    threads = [threading.Thread(target=lambda: [keep("words", KEY, b"w" * 999) for _ in range(50)]) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [writer.communicate()[1] for writer in writers] == ["", "", ""]
    assert read() == b"w" * 999
    assert len(list(folder.iterdir())) == 2


def test_a_bundle_that_is_kept_is_the_bundle_of_the_file(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text("a: [1, 2.5e-300]\n" + "# long enough\n" * 100)
    first = load_yaml(file)
    (kept,) = folder.iterdir()
    for content in (b'{"a": 5}', json.dumps({"a": 6}).encode(), b"[]", b"\xff" * 50, b"[" * 9000):
        kept.write_bytes(content)
        with pytest.warns(DamagedCacheWarning, match=kept.name):
            assert load_yaml(file) == first


@pytest.mark.slow
def test_the_command_line_says_so_in_one_line(folder: Path) -> None:
    command = [sys.executable, "-m", "tonewood", "check", "monochord"]
    first = subprocess.run(command, capture_output=True, text=True)
    files = sorted(folder.iterdir())
    for file in files:
        content = bytearray(file.read_bytes())
        content[len(content) // 3] ^= 0xFF
        file.write_bytes(content)
    second = subprocess.run(command, capture_output=True, text=True)
    third = subprocess.run(command, capture_output=True, text=True)
    assert files
    assert (first.returncode, second.returncode, third.returncode) == (0, 0, 0)
    assert first.stdout == second.stdout == third.stdout
    assert first.stderr == third.stderr
    lines = [line for line in second.stderr.splitlines() if "computed again" in line]
    assert 1 <= len(lines) <= len(files)
    assert second.stderr.count("\n") == len(lines) + first.stderr.count("\n")
    folder.chmod(0o777)
    open_to_all = subprocess.run(command, capture_output=True, text=True)
    assert (open_to_all.returncode, open_to_all.stdout) == (0, first.stdout)
    assert open_to_all.stderr.count("can be written to by others") == 1


def test_files_are_the_user_s_own_to_write_whatever_the_umask(folder: Path) -> None:
    """In a folder that others may enter, the mode of a file decides who can change it."""
    folder.mkdir(mode=0o755)
    before = os.umask(0)
    try:
        keep("words", KEY, b"words")
    finally:
        os.umask(before)
    (file,) = folder.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    for mode in (0o666, 0o620, 0o602):
        file.chmod(mode)
        with pytest.warns(DamagedCacheWarning, match="can be written to by others"):
            assert read() is None
        keep("words", KEY, b"words")
        assert read() == b"words"


def test_a_folder_in_the_place_of_a_file_leaves_no_descriptor_open(folder: Path) -> None:
    keep("words", KEY, b"words")
    (file,) = folder.iterdir()
    file.unlink()
    file.mkdir()
    free = os.dup(0)
    os.close(free)
    with pytest.warns(DamagedCacheWarning, match="directory"):
        assert read() is None
    again = os.dup(0)
    os.close(again)
    assert again == free


def test_a_file_that_another_process_writes_meanwhile_is_not_removed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes between a look at its place and whatever follows, which happens once in some thousand times."""
    keep("words", "0" * 64, b"elsewhere")
    path, look, removed = folder / f"{KEY[:32]}.words", Path.lstat, []

    def lstat(self: Path) -> os.stat_result:
        if self == path and not path.exists():
            path.write_bytes(b"of another process")
            raise FileNotFoundError
        return look(self)

    monkeypatch.setattr(Path, "lstat", lstat)
    monkeypatch.setattr(Path, "is_file", lambda self: False)
    monkeypatch.setattr(Path, "unlink", lambda self, missing_ok=False: removed.append(self))
    keep("words", KEY, b"words")
    assert path not in removed
