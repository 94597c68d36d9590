from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tonewood.errors import OutputError
from tonewood.support.folder_lock import FILE, locked

HOLD = """
import sys, time
from pathlib import Path
from tonewood.support.folder_lock import locked
with locked(Path(sys.argv[1]), "another command"):
    print("held", flush=True)
    time.sleep(600)
"""


def test_one_process_at_a_time_until_it_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    link = tmp_path / "link"
    link.symlink_to(folder)
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        for place in (folder, link, tmp_path / "x" / ".." / "folder"):
            (tmp_path / "x").mkdir(exist_ok=True)
            holder = f"is in use by another command, process {process.pid}"
            with pytest.raises(OutputError, match=holder), locked(place, "this"):
                pytest.fail("two processes hold one lock")
    finally:
        process.kill()
        process.wait()
    assert (folder / FILE).exists()  # the file is left, the lock is not
    with locked(link, "this"), pytest.raises(OutputError, match="is in use by this"), locked(folder, "that"):
        pytest.fail("two holders of one lock")
    assert list(folder.iterdir()) == []


def test_an_error_frees_the_lock(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), locked(tmp_path, "this"):
        raise ZeroDivisionError
    with locked(tmp_path, "that"):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"), locked(tmp_path / "file", "this"):
        pytest.fail("a file is no folder")


@pytest.mark.skipif(os.name != "posix", reason="links and pipes")
def test_what_is_no_file_is_refused_and_the_target_of_a_link_is_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("another's")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / FILE).symlink_to(target)
    (tmp_path / "piped").mkdir()
    os.mkfifo(tmp_path / "piped" / FILE)
    for name in ("linked", "piped"):
        with pytest.raises(OutputError, match=FILE), locked(tmp_path / name, "use"):
            pass
    assert target.read_text() == "another's"


@pytest.mark.skipif(not hasattr(os, "O_DIRECTORY"), reason="folders that can be locked")
def test_a_lock_holds_when_its_file_is_removed_or_replaced(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        (tmp_path / FILE).unlink()
        with pytest.raises(OutputError, match="is in use by another process"), locked(tmp_path, "this"):
            pytest.fail("two processes hold one lock")
        (tmp_path / FILE).write_text(" a stranger's")
        with pytest.raises(OutputError, match="is in use by a stranger's"), locked(tmp_path, "this"):
            pytest.fail("two processes hold one lock")
    finally:
        process.kill()
        process.wait()
    with locked(tmp_path, "this"):
        pass
    with locked(tmp_path, "this"):
        (tmp_path / FILE).unlink()
        (tmp_path / FILE).write_text("another's")
    assert (tmp_path / FILE).read_text() == "another's"


@pytest.mark.skipif(not hasattr(os, "O_DIRECTORY"), reason="folders that can be locked")
def test_where_no_folder_can_be_locked_the_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on network disks, on which a lock needs a file that is open for writing."""
    import fcntl

    lock = fcntl.flock

    def flock(handle: int, operation: int) -> None:
        if os.path.samestat(os.fstat(handle), tmp_path.stat()):
            raise OSError(9, "Bad file descriptor")
        lock(handle, operation)

    monkeypatch.setattr(fcntl, "flock", flock)
    with locked(tmp_path, "this"), pytest.raises(OutputError, match="is in use by this"), locked(tmp_path, "that"):
        pytest.fail("two holders of one lock")
    assert list(tmp_path.iterdir()) == []
