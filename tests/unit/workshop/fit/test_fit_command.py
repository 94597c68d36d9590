"""``tonewood fit`` and ``tonewood new``: from files to an instrument that plays the measured body."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import soundfile as sf
from fit_scenes import TAU, random_body

import tonewood as tw
from tonewood.cli.main import run
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.fit import figure
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses

FREQ = np.arange(70.0, 600.0)
TRUTH = random_body(3, seed=2, n_points=2, high=520.0)
#: residues of one microphone, Pa/(N s): phases as air turns them
SOUND = np.array([40.0 + 10j, -25.0 + 30j, 15.0 - 35j])


def pressure(freq):
    """Of the truth's poles, by partial fractions."""
    s = 1j * TAU * freq[:, None]
    w, zeta = TAU * TRUTH.freq, 0.5 / TRUTH.quality
    pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    return (SOUND / (s - pole) + SOUND.conj() / (s - pole.conj())).sum(axis=1)


def noisy(row, seed, share=0.002):
    rng = np.random.default_rng(seed)
    size = share * np.sqrt(np.mean(np.abs(row) ** 2) / 2)
    return row + size * (rng.normal(size=row.shape) + 1j * rng.normal(size=row.shape))


def write_table(path, names=("bridge", "edge"), microphone=True):
    mobility = TRUTH.mobility(FREQ)
    columns = {f"{name}:{names[0]}": noisy(row, i) for i, (name, row) in enumerate(zip(names, mobility, strict=False))}
    if microphone:
        columns[f"front_Pa:{names[0]}"] = noisy(pressure(FREQ), 7)
    head = ["freq_Hz", *(f"{name}_{part}" for name in columns for part in ("re", "im"))]
    rows = np.column_stack([FREQ, *(part for row in columns.values() for part in (row.real, row.imag))])
    path.write_text(",".join(head) + "\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n")
    return path


def command(*words):
    with pytest.raises(SystemExit) as ended:
        run([str(word) for word in words])
    return ended.value.code


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_table(tmp_path / "bridge.csv")
    return tmp_path


@pytest.mark.slow
def test_the_way_from_a_file_to_a_sound(folder, capsys):
    options = ["--form", "mobility", "--measured-by", "A. Maker", "--json"]
    assert command("fit", "bridge.csv", "-o", "fitted", *options) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["schema"] == "tonewood-fit/1"
    assert said["measured_by"] == "A. Maker"
    assert said["licence"] == "unknown"
    assert said["files"] == {"bridge.csv": hashlib.sha256((folder / "bridge.csv").read_bytes()).hexdigest()}
    measured = [row for row in said["modes"] if row["measured"]]
    assert [row["freq_Hz"] for row in measured] == pytest.approx(TRUTH.freq.tolist(), rel=1e-3)
    assert [1 / row["mass_kg"] for row in measured] == pytest.approx(TRUTH.residues[0].tolist(), rel=0.05)
    assert json.loads((folder / "fitted" / "fit.json").read_text())["modes"] == said["modes"]
    assert sorted(path.name for path in (folder / "fitted").iterdir()) == [
        "body.csv", "body.yaml", "fit.json", "fit.png", "radiation.csv"
    ]  # fmt: skip

    assert command("new", "mine", "--from", "fitted") == 0
    lines = (folder / "mine" / "instrument.yaml").read_text().splitlines()
    assert lines[0] == "# yaml-language-server: $schema=instrument.schema.json"
    assert sum(line.startswith("# DECIDE") for line in lines) >= 6
    mine = tw.load_instrument("mine")
    assert mine.origins.of("body.table").kind == "measured"
    assert "measured by A. Maker" in mine.spec.sources["measurement"].text
    assert mine.origins.of("strings.E2.length").kind == "unknown"
    assert not mine.origins.table_doubts()
    basis = mine.body.basis(1e4)
    for point, wanted in zip(("bridge", "edge"), TRUTH.mobility(FREQ), strict=True):
        assert np.abs(basis.frf(FREQ, point, "bridge") - wanted).max() < 0.01 * np.abs(wanted).max()
    bank = mine.pickups["microphones"].basis(1e4)
    heard = bank.frf(FREQ, "front", "heave", "receptance")
    assert np.abs(heard - pressure(FREQ)).max() < 0.02 * np.abs(pressure(FREQ)).max()

    tw.write_midi(tw.Score([tw.Note(0.0, 0.3, note=45)]), folder / "a.mid")
    assert command("render", "a.mid", "-i", "mine", "-o", "a.wav", "--max-duration", "0.3") == 0
    assert np.abs(sf.read("a.wav")[0]).max() > 1e-4


def test_numbers_are_the_same_after_reading(folder):
    """17 digits: a compliance of rank one stays positive semidefinite, and a bundle made of it plays the fit's body."""
    assert command("fit", "bridge.csv", "-o", "fitted", "--form", "mobility") == 0
    facts = json.loads((folder / "fitted" / "fit.json").read_text())
    parts = load_yaml(folder / "fitted" / "body.yaml")
    assert parts["body"]["truncation"]["residual_compliance"] == facts["compliance_m_per_N"]
    rows = [line.split(",") for line in (folder / "fitted" / "body.csv").read_text().splitlines() if line[0] != "#"]
    assert [[float(x) for x in row[:4]] for row in rows[1:]] == [
        [mode["freq_Hz"], mode["Q"], *mode["shape"]] for mode in facts["modes"]
    ]
    sha256 = hashlib.sha256((folder / "fitted" / "body.csv").read_bytes()).hexdigest()
    assert parts["provenance"]["body"] == {"kind": "measured", "source": "measurement", "sha256": sha256}
    assert "measured by unknown" in parts["sources"]["measurement"]["text"]


def test_points_get_names_directions_and_places(folder):
    write_table(folder / "nodes.csv", names=("12+3", "7-2"), microphone=False)
    options = ["--form", "mobility", "--point", "12+3=saddle::0.5"]
    assert command("fit", "nodes.csv", "-o", "fitted", *options) == 0
    points = load_yaml(folder / "fitted" / "body.yaml")["body"]["points"]
    assert points == {"saddle": {"direction": "z", "u": 0.5}, "n7_y_back": {"direction": [0.0, -1.0, 0.0]}}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--form", "speed"], "--form: is 'speed'; receptance, mobility, accelerance are allowed"),
        (["--form", "mobility", "--band", "300", "310"], "--band: 11 bins lie between 300 and 310 Hz"),
        (["--form", "mobility", "--damping", "none"], "--damping: is 'none'; viscous, structural, auto are allowed"),
        (["--form", "mobility", "--keep", "200,x"], "--keep: 'x' is no frequency"),
        (["--form", "mobility", "--drop", "-3"], "--drop: '-3' is no frequency"),
        (["--form", "mobility", "--point", "bridge=Q"], "'Q' cannot be the name of a point"),
        (["--form", "mobility", "--point", "bridge=edge"], "two points would be called 'edge'"),
        (["--form", "mobility", "--point", "bridge=b:q"], "the directions x, y, z are allowed"),
        (["--form", "mobility", "--point", "bridge=b:z:3"], "from -1 (bass) to 1 (treble)"),
        (["--form", "mobility", "--driving", "bridge"], "--driving: frequency responses name their references"),
        (["--form", "mobility", "--window-tau", "0"], "--window-tau: is 0 s"),
        (["--form", "mobility", "--estimator", "H3"], "--estimator: is 'H3'"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line_and_nothing_is_written(folder, capsys, options, reason):
    before = sorted(path.name for path in folder.iterdir())
    assert command("fit", "bridge.csv", "-o", "fitted", *options) == 2
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
    assert sorted(path.name for path in folder.iterdir()) == before


def test_incoherent_bands(folder, capsys):
    """A hammer that reaches to 450 Hz: a warning that says where it does not."""
    write_table(folder / "c.csv", names=("bridge",), microphone=False)
    header, *rows = (folder / "c.csv").read_text().splitlines()
    rows = [f"{row},{0.999 if float(row.split(',')[0]) < 450 else 0.2}" for row in rows]
    (folder / "c.csv").write_text("\n".join([f"{header},bridge:bridge_coherence", *rows]) + "\n")
    assert command("fit", "c.csv", "-o", "fitted", "--form", "mobility") == 0
    warned = capsys.readouterr().err
    assert "the coherence at bridge is low: 450 to 599 Hz" in warned
    assert "the coherences were not used: --hits" in warned


def test_an_instrument_is_not_written_over(folder, capsys):
    assert command("new", "mine", "--from", "monochord") == 0
    assert command("fit", "bridge.csv", "-o", "mine", "--form", "mobility") == 2
    assert command("new", "mine", "--from", "monochord") == 2
    assert command("new", "no good", "--from", "monochord") == 2
    assert command("new", "other", "--from", "mime") == 2
    assert not (folder / "other").exists()


def test_a_folder_that_cannot_be_completed_is_left_as_it_was(folder, monkeypatch):

    def broken(fit, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure, "draw_fit", broken)
    assert command("fit", "bridge.csv", "-o", "fitted", "--form", "mobility") == 2
    assert not (folder / "fitted").exists()
    (folder / "fitted").mkdir()
    (folder / "fitted" / "body.csv").write_text("old")
    assert command("fit", "bridge.csv", "-o", "fitted", "--form", "mobility") == 2
    assert [path.name for path in (folder / "fitted").iterdir()] == ["body.csv"]
    assert (folder / "fitted" / "body.csv").read_text() == "old"


@pytest.mark.parametrize("name", sorted(tw.list_instruments()))
def test_every_instrument_can_be_copied(tmp_path, name):
    """The copy has the same values and plays; it credits nothing to anybody, and its editor knows the schema."""
    assert command("new", tmp_path / "mine", "--from", name) == 0
    original, copy = tw.load_instrument(name), tw.load_instrument(tmp_path / "mine")
    changed = {"name", "title", "description", "provenance"}
    assert {k: v for k, v in copy.resolved.items() if k not in changed} == {
        k: v for k, v in original.resolved.items() if k not in changed
    }
    assert {entry.kind for entry in copy.spec.provenance.values()} == {"unknown"}
    assert copy.spec.provenance.keys() == original.spec.provenance.keys()
    schema = json.loads((tmp_path / "mine" / "instrument.schema.json").read_text())
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator(schema).validate(load_yaml(tmp_path / "mine" / "instrument.yaml"))


def test_a_copy_takes_another_string_set(tmp_path):
    assert command("new", tmp_path / "mine", "--from", "steel_strings", "--strings", "ej16") == 0
    mine = tw.load_instrument(tmp_path / "mine")
    assert mine.spec.strings_from == "ej16"
    assert mine.origins.of("strings.E2.tension").source == "strings_ej16"
    assert command("new", tmp_path / "again", "--from", tmp_path / "mine") == 0
    assert tw.load_instrument(tmp_path / "again").origins.of("strings.E2.tension").source == "strings_ej16"
    assert mine.resolved["strings"]["B3"]["bending_stiffness"] == pytest.approx(np.pi * 2e11 * 0.406e-3**4 / 64)


def test_ctrl_c_leaves_nothing(folder):
    """In another process, which is stopped while it fits."""
    write_table(folder / "b.csv")
    code = (
        "import os, signal, sys\n"
        "from tonewood.cli.main import run\n"
        "import tonewood.workshop.fit.fit as f\n"
        "real = f.identify\n"
        "def stopped(*a, **k):\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored by background jobs of a shell
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    return real(*a, **k)\n"
        "f.identify = stopped\n"
        "run(sys.argv[1:])\n"
    )
    words = ["fit", "b.csv", "-o", "fitted", "--form", "mobility"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        env=dict(os.environ),
        check=False,
    )
    assert done.returncode == 130
    assert re.fullmatch(r"tonewood: interrupted; nothing was written\n", done.stderr)
    assert not (folder / "fitted").exists()


def test_curves_of_the_figure_are_those_of_the_fit(folder, monkeypatch):
    """Measured and fitted mobility of each pair lie over each other, pairs apart; below them their difference."""
    made = []
    monkeypatch.setattr(figure, "save", lambda drawn, path: made.append(drawn))
    fit = fit_responses(read_responses([folder / "bridge.csv"], Reading("mobility")))
    figure.draw_fit(fit, folder / "fit.png")
    top, off = made[0].axes[:2]
    measured, fitted = top.lines[1::2], top.lines[2::2]
    assert len(measured) == len(fitted) == len(fit.responses.pairs) == 2
    for i, (grey, line, error) in enumerate(zip(measured, fitted, off.lines, strict=False)):
        shift = grey.get_ydata() - 20 * np.log10(np.abs(fit.responses.mobility[i]))
        assert np.ptp(shift) < 1e-9
        assert np.ptp(line.get_ydata() - 20 * np.log10(np.abs(fit.mobility[i])) - shift) < 1e-9
        assert error.get_ydata() == pytest.approx(line.get_ydata() - grey.get_ydata(), abs=1e-9)
        assert (shift[0] < -1.0) == (i > 0)
        assert not i or f", {shift[0]:g} dB" in line.get_label()
