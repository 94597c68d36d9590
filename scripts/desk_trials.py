"""Ten minutes of a luthier at the desk, by a script in Chromium: `python scripts/desk_trials.py`.

On the drawn guitar an end of a brace is moved by the arrow keys, another set of strings is put on, wolf notes are
looked for, a tuned damper is put under the bridge by the form, wolf notes are looked for again, the design is saved,
and rendered and compared by commands. Each step is printed with its seconds. Needs Chromium and chromedriver.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from browser import Driven, driven  # noqa: E402

EXACT = "window.desk?.state?.modes && desk.state.making === null && !desk.state.preview"
WOLVES = "[...document.querySelectorAll('#wolves_list li')].map(li => li.textContent)"


def wolves(browser: Driven) -> list[str]:
    """Wolf notes that the page tells."""
    browser.click("#wolves_go")
    browser.until("document.getElementById('wolves_go').textContent === 'Look again'", 300)
    return [str(line) for line in browser.run(f"return {WOLVES}")]


def chosen(browser: Driven, select: str, value: str) -> None:
    """Choose an option of a list."""
    browser.run(
        f"const s = document.getElementById('{select}'); s.value = '{value}'; s.dispatchEvent(new Event('change'))"
    )


def told(began: float, words: str) -> None:
    """Print a step and its time."""
    print(f"{time.monotonic() - began:6.0f} s  {words}", flush=True)


def main() -> None:
    """Make the trial."""
    command = [sys.executable, "-m", "tonewood", "desk", "drawn_guitar", "--port", "0"]
    with tempfile.TemporaryDirectory() as made, driven(1280) as browser:
        began, saved = time.monotonic(), Path(made) / "my_guitar"
        process = subprocess.Popen([*command, "--folder", made], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            browser.open(process.stdout.readline().strip())
            browser.until(EXACT, 300)
            browser.click("#play")
            told(began, "the exact sound of the start")
            browser.until("document.querySelector('#drawing [data-end=\"body.braces.fan_1.stop\"]')", 60)
            browser.run("document.querySelector('#drawing [data-end=\"body.braces.fan_1.stop\"]').focus()")
            browser.press("Right", "Right", "Right", "Right")
            browser.until("desk.state.changes.length === 1")
            browser.until(EXACT, 300)
            told(began, "a brace is moved by 4 mm")
            chosen(browser, "sets", "ej46")
            browser.until("desk.state.changes.length === 2")
            browser.until(EXACT, 300)
            told(began, "another set of strings")
            for line in wolves(browser)[:8]:
                told(began, line)
            chosen(browser, "mass_at", "saddle_G3")
            for field, value in (("mass_g", 6), ("mass_frequency", 220), ("mass_q", 3)):
                browser.run(f"document.getElementById('{field}').value = {value}")
            browser.click("#mass button")
            browser.until("desk.state.added.length === 1")
            browser.until(EXACT, 300)
            told(began, "6 g on a spring, 220 Hz, Q 3, at saddle_G3")
            for line in wolves(browser)[:12]:
                told(began, line)
            browser.run(f"document.getElementById('save_folder').value = '{saved}'")
            browser.click("#save button")
            browser.until("document.getElementById('said').textContent.includes('saved')", 60)
            line = browser.run("return document.getElementById('command').value")
            told(began, "saved")
        finally:
            process.terminate()
            process.wait()
        run = [sys.executable, "-m", *shlex.split(line)]
        subprocess.run(run, check=True, cwd=made, stdout=subprocess.DEVNULL)
        told(began, f"rendered: {line[:60]} ...")
        compare = ["compare", "drawn_guitar", str(saved), "--notes", "E2", "-o", f"{made}/both.html"]
        subprocess.run([sys.executable, "-m", "tonewood", *compare], check=True, stdout=subprocess.DEVNULL)
        told(began, "compared with the start")


if __name__ == "__main__":
    main()
