"""Time of a start: import, load and first block, each in a fresh process; and the rest without imports.

    python benchmarks/start.py [--instrument classical_guitar] [--rounds 15]

Byte code of the sources is written once, as an installed wheel has it. Three ways in turn: nothing kept between runs
(`TONEWOOD_CACHE=off`), a filled cache folder, and NumPy and pydantic imported alone, which no start can do without. A
row has the least and the median of wall time, and the least of processor time and of the three parts.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile

START = """
import json, sys, time
began, cpu = time.perf_counter(), time.process_time()
import tonewood as tw
tw.Renderer, tw.load_instrument
imported = time.perf_counter()
made = tw.load_instrument(sys.argv[1])
loaded = time.perf_counter()
string = made.string_names[0]
score = tw.Score([tw.Note(0.0, 1.0, string=string)])
blocks = tw.Renderer(score, made, 48000).blocks(512)
next(iter(blocks))
now = time.perf_counter()
print(json.dumps([now - began, time.process_time() - cpu, imported - began, loaded - imported, now - loaded]))
"""
FLOOR = """
import json, sys, time
began, cpu = time.perf_counter(), time.process_time()
import numpy, pydantic
pydantic.BaseModel
now = time.perf_counter()
print(json.dumps([now - began, time.process_time() - cpu, now - began, 0.0, 0.0]))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instrument", default="classical_guitar")
    parser.add_argument("--rounds", type=int, default=15)
    args = parser.parse_args()
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as code_folder:
        common = inherited | {"PYTHONPYCACHEPREFIX": code_folder, "OMP_NUM_THREADS": "1"}
        ways = {
            "nothing kept": (START, "off"),
            "cache filled": (START, folder),
            "NumPy and pydantic alone": (FLOOR, "off"),
        }
        times: dict[str, list[list[float]]] = {name: [] for name in ways}
        for i in range(-1, args.rounds):
            for name, (code, cache) in ways.items():
                done = subprocess.run(
                    [sys.executable, "-c", code, args.instrument],
                    env=common | {"TONEWOOD_CACHE": cache},
                    capture_output=True,
                    check=True,
                    text=True,
                )
                if i >= 0:  # the first round fills the cache, and the system's own of files
                    times[name].append(json.loads(done.stdout))
    print("| start | least, s | median, s | processor, least, s | import | load | first block |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name, rows in times.items():
        whole, cpu, *parts = zip(*rows, strict=True)
        shown = [min(whole), statistics.median(whole), min(cpu), *(min(part) for part in parts)]
        print(f"| {name} | " + " | ".join(f"{value:.3f}" for value in shown) + " |")


if __name__ == "__main__":
    main()
