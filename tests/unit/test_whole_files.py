"""Files that are whole or not there, whatever comes between."""

from __future__ import annotations

import errno
import gc
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tonewood.errors import OutputError
from tonewood.support.whole_files import AtomicFile, whole_file, write_whole


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.txt"
    with whole_file(path, make_folder=True) as stream:
        stream.write(b"first")
        assert not path.exists()
    assert path.read_bytes() == b"first"
    write_whole(path, "µ")
    assert path.read_bytes() == "µ".encode()
    assert [p.name for p in path.parent.iterdir()] == ["file.txt"]


@pytest.mark.parametrize("stop", [RuntimeError, KeyboardInterrupt])
def test_what_is_broken_off_leaves_the_old_file(tmp_path: Path, stop: type[BaseException]) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"first")

    def broken() -> None:
        with whole_file(path) as stream:
            stream.write(b"second, broken")
            raise stop

    with pytest.raises(stop):
        broken()
    assert path.read_bytes() == b"first"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("statement", range(1, 60))
def test_ctrl_c_between_any_two_statements_leaves_nothing(tmp_path: Path, statement: int) -> None:
    """An interruption before the n-th line executed in the module, wherever that is."""
    counted = 0

    def trace(frame: object, event: str, _: object) -> object:
        nonlocal counted
        if frame.f_code.co_filename.endswith("whole_files.py"):  # type: ignore[attr-defined]  # a frame
            if event == "line":
                counted += 1
                if counted == statement:
                    raise KeyboardInterrupt
            return trace
        return None

    def begun() -> None:
        part = AtomicFile(tmp_path / "file")
        sys.settrace(None)
        assert part.path.exists()
        raise KeyboardInterrupt  # no statement was left

    sys.settrace(trace)
    try:
        with pytest.raises(KeyboardInterrupt):
            begun()
    finally:
        sys.settrace(None)
    assert list(tmp_path.iterdir()) == []


def test_the_end_of_the_program_removes_what_is_incomplete(tmp_path: Path) -> None:
    program = (
        "from tonewood.support.whole_files import AtomicFile\n"
        f"kept = AtomicFile({str(tmp_path / 'a')!r})\nassert kept.path.exists()"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    assert list(tmp_path.iterdir()) == []


def test_links_lead_to_the_file_and_permissions_are_those_of_any_file(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "far" / "file")
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "link", b"1")
    finally:
        os.umask(before)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "far" / "file").read_bytes() == b"1"
    assert (tmp_path / "far" / "file").stat().st_mode & 0o777 == 0o640


def test_what_cannot_be_a_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"1")
    for path, said in (
        (tmp_path / "nowhere" / "file", "there is no folder"),
        (tmp_path / "file" / "below", "there is no folder"),
        (tmp_path, "is a folder"),
        (Path("/dev/null"), "is no file but a device"),
        (tmp_path / ("long" * 100), "cannot be written: File name too long"),
    ):
        with pytest.raises(OutputError, match=said) as error:
            write_whole(path, b"2")
        assert str(error.value).startswith(f"{path}: ")
    with pytest.raises(OutputError, match="cannot be written"), whole_file(tmp_path / "file" / "x", make_folder=True):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_what_cannot_be_removed_is_reported_unless_something_worse_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = AtomicFile(tmp_path / "file")

    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", refuse)
        with pytest.raises(OutputError, match="cannot be removed: Read-only file system"):
            part.discard()

        def broken() -> None:
            with whole_file(tmp_path / "other"):
                raise OutputError("the disk is full")

        with pytest.raises(OutputError, match="the disk is full"):
            broken()


def test_where_nothing_can_be_written_nothing_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A read-only file system refuses to remove even a file that is not there, at the end of the program, too."""
    tried: list[Path] = []

    def refuse(path: Path, *_: object, **__: object) -> None:
        tried.append(path)
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "open", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(OutputError, match="cannot be written: Read-only file system"):
        AtomicFile(tmp_path / "out.txt")
    gc.collect()
    assert tried == [tmp_path / ".out.0.part.txt"] * 2  # looked for a leftover, and tried to make it


def incomplete(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir() if ".part" in p.name)


#: writes some bytes beside the target, says so and waits
WRITER = (
    "import sys\nfrom tonewood.support.whole_files import AtomicFile\nfile = AtomicFile(sys.argv[1])\n"
    "file.path.write_bytes(b'half')\nprint('begun', flush=True)\nsys.stdin.read()\n"
)


def writer(target: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(target)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    return process


def test_what_a_killed_program_leaves_is_removed_by_the_next_one(tmp_path: Path) -> None:
    """Files of programs that still run are not touched, whichever of three came first."""
    target = tmp_path / "out.wav"
    one, two, three = (writer(target) for _ in range(3))
    for killed in (two, three):
        killed.kill()
        killed.communicate()
    assert incomplete(tmp_path) == [f".out.{i}.part.wav" for i in range(3)]
    write_whole(target, b"whole")
    assert incomplete(tmp_path) == [".out.0.part.wav"]
    assert (tmp_path / ".out.0.part.wav").read_bytes() == b"half"
    one.kill()
    one.communicate()
    assert incomplete(tmp_path) == [".out.0.part.wav"]
    write_whole(tmp_path / "other.wav", b"")
    assert incomplete(tmp_path) == [".out.0.part.wav"]  # of another target
    write_whole(target, b"whole")
    assert incomplete(tmp_path) == []
    assert target.read_bytes() == b"whole"


def test_more_writers_of_one_target_than_numbers(tmp_path: Path) -> None:
    files = [AtomicFile(tmp_path / "out.txt") for _ in range(12)]
    for i, file in enumerate(files):
        file.path.write_text(str(i))
    assert len(incomplete(tmp_path)) == 12
    for file in files:
        file.complete()
    assert [p.read_text() for p in tmp_path.iterdir()] == ["11"]


def test_a_name_that_is_taken_is_left_alone(tmp_path: Path) -> None:
    """A link or a folder where the new file would be: another number is taken, and nothing behind them is touched."""
    (tmp_path / "far").write_bytes(b"kept")
    (tmp_path / ".out.0.part.txt").symlink_to(tmp_path / "far")
    (tmp_path / ".out.1.part.txt").mkdir()
    write_whole(tmp_path / "out.txt", b"new")
    assert (tmp_path / "far").read_bytes() == b"kept"
    assert incomplete(tmp_path) == [".out.0.part.txt", ".out.1.part.txt"]
    assert (tmp_path / "out.txt").read_bytes() == b"new"


def test_where_files_cannot_be_locked_they_are_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", refuse)
    one, two = AtomicFile(tmp_path / "out.txt"), AtomicFile(tmp_path / "out.txt")
    one.path.write_bytes(b"1")
    two.path.write_bytes(b"2")
    one.complete()
    assert (tmp_path / "out.txt").read_bytes() == b"1"
    two.discard()
    assert incomplete(tmp_path) == []


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_a_file_that_another_writer_is_about_to_remove_is_not_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between its creation and its lock a file looks like a leftover: who loses the lock takes another name."""
    import fcntl

    first, others, flock = tmp_path / ".a.0.part.bin", [], fcntl.flock

    def late(handle: int, how: int) -> None:
        if not others and first.exists():
            others.append(os.open(first, os.O_RDWR))
            flock(others[0], how)
        flock(handle, how)

    monkeypatch.setattr(fcntl, "flock", late)
    file = AtomicFile(tmp_path / "a.bin")
    assert others
    assert file.path != first
    first.unlink()  # as the other writer does
    os.close(others[0])
    file.path.write_bytes(b"whole")
    file.complete()
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_a_link_into_a_folder_that_is_not_there_names_it(tmp_path: Path) -> None:
    (tmp_path / "a.wav").symlink_to(tmp_path / "none" / "b.wav")
    with pytest.raises(OutputError, match=re.escape(f"a.wav: there is no folder '{tmp_path / 'none'}'")):
        AtomicFile(tmp_path / "a.wav")
