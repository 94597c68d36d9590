"""The installed command as a process of its own: interrupted, on a full disk, from elsewhere, spawned."""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import os
import pty
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from midi_bytes import note, write

TONEWOOD = [sys.executable, "-m", "tonewood"]


@pytest.fixture
def score(tmp_path: Path) -> Path:
    return write(tmp_path / "score.mid", note(0.0, 0.2, 45))


@pytest.mark.slow
def test_ctrl_c_leaves_no_file_and_code_130(tmp_path: Path) -> None:
    events = [e for i in range(2000) for e in note(0.3 * i, 0.2, 45 + i % 12)]
    process = subprocess.Popen(
        [*TONEWOOD, "render", write(tmp_path / "long.mid", events), "-i", "monochord", "-o", tmp_path / "out.wav"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )  # fmt: skip
    while not list(tmp_path.glob(".out.*")):  # it has begun to write
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=600)
    assert process.returncode == 130
    assert out == ""
    assert err == "tonewood: interrupted; nothing was written\n"
    assert [p.name for p in tmp_path.iterdir()] == ["long.mid"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "where",
    [
        "tonewood.cli.app.import_module = stop",  # before there is a command
        "typer.Typer.__call__ = stop",
        "tonewood.cli.listing.print = stop",
    ],
)
def test_ctrl_c_at_any_time_is_one_line_and_code_130(where: str) -> None:
    """Through a call of exec, as when modules are imported: CPython itself would then end by the signal."""
    program = (
        "import sys, typer, typer.core, tonewood.cli.app, tonewood.cli.listing\n"
        "def stop(*_, **__):\n    exec('raise KeyboardInterrupt')\n"
        f"{where}\nfrom tonewood.cli.main import run\nrun(['list'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "tonewood: interrupted; nothing was written\n")


#: sends itself a signal at the n-th event (import, file, call of exec) after the program's first line
SIGNALLED = """
import os, signal, sys
n, number, count = int(sys.argv[1]), int(sys.argv[2]), 0
def hook(event, args):
    global count
    if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
        return
    if event in ("import", "open", "exec", "compile", "os.listdir", "os.scandir", "marshal.loads"):
        count += 1
        if count == n:
            os.kill(os.getpid(), number)
sys.addaudithook(hook)
del sys.argv[1:3]
from tonewood.cli.start import main
try:
    main()
finally:
    print(count, file=sys.stderr)
"""


def signalled(n: int, number: int, folder: Path, score: Path) -> subprocess.CompletedProcess[str]:
    words = ["render", str(score), "-i", "monochord", "-o", str(folder / "out.wav"), "--fs", "16000"]
    return subprocess.run(
        [sys.executable, "-c", SIGNALLED, str(n), str(int(number)), *words, "--max-duration", "0.1"],
        capture_output=True, text=True, check=False,
        preexec_fn=lambda: [signal.signal(n, signal.SIG_DFL) for n in (signal.SIGINT, signal.SIGHUP)],
    )  # fmt: skip


@pytest.fixture(scope="module")
def events(tmp_path_factory: pytest.TempPathFactory) -> int:
    """Number of events of the whole program."""
    folder = tmp_path_factory.mktemp("whole")
    score = write(folder / "score.mid", note(0.0, 0.2, 45))
    return int(signalled(0, signal.SIGINT, folder, score).stderr.splitlines()[-1])


LATER = [pytest.param(i / 60, signal.SIGINT, marks=pytest.mark.validate) for i in range(60)]
SWEEP = [
    (0.2, signal.SIGINT), (0.6, signal.SIGTERM), (0.95, signal.SIGHUP),
    *(pytest.param(share, signal.SIGINT, marks=pytest.mark.slow) for share in (0.0, 0.9)),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("share", "number"), [*SWEEP, *LATER])
def test_a_signal_at_any_time_is_one_line(share: float, number: int, tmp_path: Path, score: Path, events: int) -> None:
    """From the first line of the program on: imports of modules in C turn the exception into others, or lose it."""
    assert events > 1000
    done = signalled(1 + round(share * events), number, tmp_path, score)
    lines = [line for line in done.stderr.splitlines() if not line.isdecimal()]
    if (tmp_path / "out.wav").exists():
        assert done.returncode in (0, 128 + number)
        assert lines in ([], [f"tonewood: {WORDS[number]}; out.wav is written"])
    else:
        assert done.returncode == 128 + number
        assert lines == [f"tonewood: {WORDS[number]}; nothing was written"]
    assert not [p.name for p in tmp_path.iterdir() if p.name not in ("score.mid", "out.wav")]


WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}


@pytest.mark.slow
def test_an_interruption_that_a_callback_swallows_is_raised_again() -> None:
    program = (
        "import os, signal, sys, time, weakref\nimport tonewood.cli.listing\n"
        "class Thing: pass\n"
        "def lost(_):\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(0.01)\n"
        "def stop(*_, **__):\n    thing = Thing()\n    kept = weakref.ref(thing, lost)\n"
        "    del thing\n    time.sleep(60)\n"
        "tonewood.cli.listing.print = stop\nsys.argv[1:] = ['list']\n"
        "from tonewood.cli.start import main\nmain()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=50,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "tonewood: interrupted; nothing was written\n")


@pytest.mark.slow
def test_signals_that_are_ignored_stay_ignored(tmp_path: Path, score: Path) -> None:
    """As by nohup, and in the background jobs of a shell."""
    done = subprocess.run(
        [sys.executable, "-c", SIGNALLED.replace("signal.getsignal(number) in", "signal.getsignal(15) in"),
         "1500", str(int(signal.SIGHUP)), "render", score, "-i", "monochord", "-o", tmp_path / "out.wav",
         "--max-duration", "0.1"],
        capture_output=True, text=True, check=False,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )  # fmt: skip
    assert done.returncode == 0
    assert (tmp_path / "out.wav").exists()


@pytest.mark.slow
@pytest.mark.parametrize("more", [[], ["--normalize", "-3"]])
def test_a_full_disk_is_one_line_and_no_file(tmp_path: Path, score: Path, more: list[str]) -> None:
    """Files may grow to 50 kB here, as on a disk with as much left."""
    result = subprocess.run(
        [*TONEWOOD, "render", score, "-i", "monochord", "-o", tmp_path / "out.wav", "--max-duration", "1.0", *more],
        capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000)),
    )  # fmt: skip
    assert result.returncode == 2
    assert result.stderr == f"tonewood: {tmp_path / 'out.wav'}: cannot be written: File too large\n"
    assert [p.name for p in tmp_path.iterdir()] == ["score.mid"]


def test_worker_processes_run_no_module_of_the_current_folder(tmp_path: Path) -> None:
    """Files beside a manifest or a bundle are data, also those called as modules that a worker imports."""
    for name in ("joblib", "numpy", "random", "tonewood"):
        (tmp_path / f"{name}.py").write_text("open('run', 'w').close()\nraise ImportError('not this one')\n")
    words = ["--every", "24", "--velocities", "64", "--round-robins", "1", "--duration", "0.5", "--fs", "8000"]
    result = subprocess.run(
        [sys.executable, "-P", "-m", "tonewood", "sample", "monochord", "-o", "a.sfz", *words, "--jobs", "2"],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "a.sfz").exists()
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_from_another_folder_with_relative_paths_and_a_pipe(tmp_path: Path, score: Path) -> None:
    result = subprocess.run(
        [*TONEWOOD, "render", "score.mid", "-i", "monochord", "-o", "out.flac", "--max-duration", "0.2", "--json"],
        capture_output=True, text=True, check=True, cwd=tmp_path,
    )  # fmt: skip
    assert json.loads(result.stdout)["output"] == "out.flac"
    assert result.stderr == ""  # no progress bar, no escapes
    assert sf.info(str(tmp_path / "out.flac")).frames == 9600
    assert score.exists()


@pytest.mark.slow
def test_a_terminal_gets_a_progress_bar(tmp_path: Path, score: Path) -> None:
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*TONEWOOD, "render", score, "-i", "monochord", "-o", tmp_path / "out.wav", "--max-duration", "0.5"],
        stdout=subprocess.DEVNULL, stderr=theirs, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    while True:  # while it runs: a terminal that nobody reads holds a few thousand characters and then blocks
        try:
            part = os.read(ours, 4096)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(ours)
    assert process.wait() == 0
    assert b"rendering" in shown
    assert b"%" in shown


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error() -> None:
    result = subprocess.run(
        f"{' '.join(TONEWOOD)} schema | head -n 1", shell=True, capture_output=True, text=True, check=False
    )
    assert result.stdout.strip() == "{"
    assert result.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "code", "said"),
    [
        ("list > /dev/full", 2, "tonewood: standard output: cannot be written: No space left on device\n"),
        ("list >&-", 0, ""),
        ("render absent.mid -i monochord -o a.wav 2>&-", 2, ""),
        ("render absent.mid -i monochord -o a.wav 2> /dev/full", 2, ""),
    ],
)
def test_nowhere_to_write_to(where: str, code: int, said: str) -> None:
    result = subprocess.run(f"{' '.join(TONEWOOD)} {where}", shell=True, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (code, "", said)


@pytest.mark.slow
def test_rendering_without_standard_error(tmp_path: Path, score: Path) -> None:
    command = f"{' '.join(TONEWOOD)} render {score} -i monochord -o {tmp_path / 'a.wav'} --max-duration 0.1 --json 2>&-"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert json.loads(result.stdout)["frames"] == 4800


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        (["batch", "absent.yaml", "-o", "out"], "joblib"),
        (["batch", "absent.yaml", "-o", "out"], "pyloudnorm"),
        (["batch", "absent.yaml", "-o", "out", "--cluster", "tcp://here:1"], "distributed"),
        (["results", "absent.csv", "--key", "absent.json"], "matplotlib"),
        (["validate", "--only", "klosner", "--plots", "out"], "matplotlib"),
        (["accuracy", "--system", "klosner_d", "--plot", "a.png"], "matplotlib"),
        (["modes", "monochord", "--plot", "a.png"], "matplotlib"),
        (["render", "absent.mid", "-i", "monochord", "-o", "a.wav", "--energy", "a.png"], "matplotlib"),
    ],
)
def test_what_an_extra_would_bring_is_named_before_any_work(
    arguments: list[str], missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    from tonewood.cli.main import run

    monkeypatch.chdir(tmp_path)
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else found(name))
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(SystemExit) as end:
        run(arguments)
    assert end.value.code == 2
    err = capsys.readouterr().err
    assert f"{missing}" in err
    assert "pip install" in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_rendering_imports_nothing_heavy_it_does_not_need(tmp_path: Path, score: Path) -> None:
    """Imports take most of a cold start."""
    program = (
        "import sys\nimport scipy.linalg\nbefore = set(sys.modules)\n"  # SciPy 1.13 brings scipy.sparse along
        "from tonewood.cli.main import run\n"
        f"try:\n    run(['render', {str(score)!r}, '-i', 'classical_guitar', '-o', {str(tmp_path / 'a.wav')!r},"
        " '--max-duration', '0.05', '--fs', '16000'])\n"
        "except SystemExit as end:\n    assert end.code == 0\n"
        "heavy = ('scipy.signal', 'scipy.optimize', 'scipy.stats', 'scipy.interpolate', 'scipy.sparse', 'scipy.fft',"
        " 'matplotlib', 'rich.progress', 'joblib', 'dask', 'sounddevice', 'mido', 'asyncio', 'tonewood.lab')\n"
        "print([name for name in heavy if name in sys.modules and name not in before])"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def _rendered(path: str) -> np.ndarray:
    audio = tw.render(tw.read_midi(path), tw.load_instrument("monochord"), 16000, max_duration=0.1)
    return audio.samples


@pytest.mark.slow
def test_a_spawned_process_renders_the_same(score: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        there = pool.apply(_rendered, (os.fspath(score),))
    assert np.array_equal(there, _rendered(os.fspath(score)))


@pytest.mark.slow
def test_the_isa_can_be_pinned(tmp_path: Path, score: Path) -> None:
    from tonewood._kernel import instruction_sets

    sounds = {}
    for isa in {instruction_sets()[0], instruction_sets()[-1]}:
        out = tmp_path / f"{isa}.wav"
        subprocess.run(
            [*TONEWOOD, "render", score, "-i", "monochord", "-o", out, "--max-duration", "0.2", "--subtype", "DOUBLE"],
            check=True, capture_output=True, env={**os.environ, "TONEWOOD_ISA": isa},
        )  # fmt: skip
        sounds[isa] = sf.read(str(out))[0]
    reference = next(iter(sounds.values()))
    for samples in sounds.values():
        assert np.abs(samples - reference).max() < 1e-10 * np.abs(reference).max()
    wrong = subprocess.run(
        [*TONEWOOD, "render", score, "-i", "monochord", "-o", tmp_path / "x.wav"],
        check=False, capture_output=True, text=True, env={**os.environ, "TONEWOOD_ISA": "mmx"},
    )  # fmt: skip
    assert wrong.returncode == 2
    assert wrong.stderr.count("\n") == 1
    assert "mmx" in wrong.stderr
