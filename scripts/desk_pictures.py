"""Pictures and a short film of the desk for docs/desk.md, made in Chromium: `python scripts/desk_pictures.py`.

A brace of the drawn guitar is moved, its set of strings changed and 5 g put on the bridge; each step is a picture.
Needs Chromium, chromedriver and Pillow.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from PIL import Image  # noqa: E402

from browser import Driven, driven  # noqa: E402

IMAGES = ROOT / "docs" / "images"
#: width of the pictures on the page, and height of the window
WIDTH, HEIGHT = 1280, 1150
STEPS = (
    ("set", {"path": "body.braces.fan_1.stop", "value": [0.38, -0.14]}),
    ("strings", {"name": "ej46"}),
    ("set", {"path": "body.added", "value": [{"at": "saddle_G3", "mass": 0.005}]}),
)


def picture(browser: Driven, folder: Path) -> Image.Image:
    """The window as it is."""
    file = folder / "window.png"
    browser.picture(file)
    shown = Image.open(io.BytesIO(file.read_bytes())).convert("RGB")
    return shown.crop((0, 0, shown.width, min(shown.height, HEIGHT)))


def settled(browser: Driven) -> None:
    """Wait until the exact sound is heard and seen."""
    browser.until("window.desk?.state?.modes && desk.state.making === null && !desk.state.preview", 300)
    time.sleep(6.0)


def main() -> None:
    """Make `desk.png`, `desk_dark.png` and `desk.gif`."""
    command = [sys.executable, "-m", "tonewood", "desk", sys.argv[1] if len(sys.argv) > 1 else "drawn_guitar"]
    process = subprocess.Popen([*command, "--port", "0"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        with driven(WIDTH, HEIGHT) as browser, tempfile.TemporaryDirectory() as made:
            folder = Path(made)
            browser.open(address)
            browser.until("window.desk?.state?.modes", 300)
            browser.click("#play")
            settled(browser)
            frames = [picture(browser, folder)]
            for act, values in STEPS:
                browser.run(f"return desk.act('{act}', {json.dumps(values)})")
                settled(browser)
                frames.append(picture(browser, folder))
            small = [f.resize((WIDTH * 5 // 8, f.height * 5 // 8)).quantize(64) for f in frames]
            frames[-1].quantize(128).save(IMAGES / "desk.png", optimize=True)
            small[0].save(
                IMAGES / "desk.gif", save_all=True, append_images=small[1:], duration=1800, loop=0, optimize=True
            )
            browser.colours("dark")
            time.sleep(2.0)
            picture(browser, folder).quantize(128).save(IMAGES / "desk_dark.png", optimize=True)
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main()
