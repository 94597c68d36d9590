"""Conditions on a real instrument, as a batch relies on them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.workshop.batch import rendering
from tonewood.workshop.batch.conditions import Condition, Draw, expand
from tonewood.workshop.batch.manifest import check_manifest
from tonewood.workshop.batch.rendering import EngineRenderer, instrument_of
from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.batch.store import content_key

ENGINE = EngineRenderer()
NOTE = {"time": 0.0, "duration": 0.3, "note": 57.0, "force": 1.0}


def manifest(**changes: Any) -> dict[str, Any]:
    data = {
        "schema": "tonewood-batch/1",
        "name": "real",
        "seed": 5,
        "instruments": {"guitar": "classical_guitar"},
        "scores": {"note": {"phrase": [NOTE]}},
        "factors": {"loss": {"path": "strings.*.loss.eta_a", "levels": {"low": {"scale": 1.0}, "high": {"scale": 30}}}},
        "render": {"output": "bridge", "tail": {"energy_db": -40, "cap": 0.3}},
        "pages": [{"type": "mushra", "reference": {"loss": "low"}, "anchors": [3500]}],
    }
    return data | changes


def conditions(**changes: Any) -> tuple[Condition, ...]:
    return expand(check_manifest(manifest(**changes)), Path())


def test_identity_is_json_and_follows_what_is_asked() -> None:
    low, high = conditions()
    assert content_key(ENGINE.identity(low)) == content_key(ENGINE.identity(low))
    assert content_key(ENGINE.identity(low)) != content_key(ENGINE.identity(high))
    identity = json.loads(json.dumps(ENGINE.identity(high), allow_nan=False))
    assert identity["version"] == tw.__version__
    before = ENGINE.identity(low)["parameters"]["strings"]["A2"]["loss"]["eta_a"]
    assert identity["parameters"]["strings"]["A2"]["loss"]["eta_a"] == pytest.approx(30 * before)
    assert set(identity["plugins"]) >= {"stiff_string", "modal_table"}
    assert len(identity["bundle"]) == 64
    (seeded, _) = conditions(seed=6)
    assert content_key(ENGINE.identity(seeded)) != content_key(ENGINE.identity(low))


def test_renders_repeat_to_the_bit_and_hear_their_factor() -> None:
    low, high = conditions()
    first, again, other = ENGINE.render(low), ENGINE.render(low), ENGINE.render(high)
    assert np.array_equal(first.samples, again.samples)
    assert first.samples.shape[1] == 1
    assert first.info["notes"] == 1
    n = min(len(first.samples), len(other.samples)) // 2
    late = slice(n, 2 * n)
    assert np.std(other.samples[late]) < 0.9 * np.std(first.samples[late])


@pytest.mark.slow
def test_a_kept_model_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Notes at several stops, in two orders, on models that were used before and on fresh ones."""
    notes = {
        f"n{m}": {"phrase": [NOTE | {"note": float(m)}, NOTE | {"time": 0.1, "note": m + 3.0}]} for m in (41, 57, 48)
    }
    given = conditions(scores=notes)

    def rendered(order: list[int], most: int) -> dict[int, np.ndarray]:
        monkeypatch.setattr(rendering, "_MODELS", rendering.ModelCache(most))
        return {i: ENGINE.render(given[i]).samples for i in order}

    fresh = rendered(list(range(len(given))), 0)
    for order in ([0, 1, 2, 3, 4, 5], [5, 2, 4, 0, 3, 1]):
        kept = rendered(order, 4)
        assert all(np.array_equal(kept[i], fresh[i]) for i in order)


def test_few_models_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def assembled(instrument: Any, options: Any, *, by_string: bool) -> str:
        made.append(instrument.content_hash)
        return "a model"

    monkeypatch.setattr(rendering, "assembled", assembled)
    cache = rendering.ModelCache(2)
    low, high = (instrument_of(c) for c in conditions())
    options = conditions()[0].render
    for instrument, at in (
        (low, options),
        (high, options),
        (low, options),
        (low, options.at(fs=44100)),
        (high, options),
    ):
        cache.of(instrument, at, by_string=False)
    assert made == [low.content_hash, high.content_hash, low.content_hash, high.content_hash]
    cache.of(high, options, by_string=True)  # another model than the last one
    assert len(made) == 5


def test_varied_force_scales_a_linear_sound() -> None:
    given = conditions()[0]
    ramp = {"exciters.pluck": {"plugin": "pluck_ramp"}}  # a finger's release depends on the force
    plain = replace(given, overrides={**given.overrides, **ramp})
    draw = Draw("exciters.pluck.force", "normal_db", 2.0, 5, ("guitar", "note", "1"))
    varied = replace(plain, draws=(draw,))
    factor = draw.values(1)[0]
    assert abs(factor - 1.0) > 1e-3
    a, b = ENGINE.render(plain).samples, ENGINE.render(varied).samples
    n = min(len(a), len(b))
    np.testing.assert_allclose(b[:n], factor * a[:n], atol=1e-9 * np.max(np.abs(a)))
    tap = replace(plain, draws=(Draw("exciters.tap.force", "normal_db", 2.0, 5, ()),))
    assert np.array_equal(ENGINE.render(tap).samples, a)  # no note is tapped


def test_place_varies_about_a_fraction_of_the_string_played() -> None:
    draw = Draw("exciters.pluck.from_bridge", "uniform", 0.01, 5, ())
    asked = replace(conditions()[0], overrides={"exciters.pluck.from_bridge": {"fraction": 0.4}}, draws=(draw,))
    # A3 is the second fret of the G string: 0.65 m / 2^(2/12)
    place = 0.4 * 0.65 / 2 ** (2 / 12) + float(draw.values(1)[0])
    assert asked.notes is not None
    set_by_hand = replace(asked, notes=(replace(asked.notes[0], from_bridge=place),), draws=())
    np.testing.assert_allclose(ENGINE.render(asked).samples, ENGINE.render(set_by_hand).samples, atol=1e-12)


def test_parameters_of_the_instrument_vary_once_a_repeat() -> None:
    plain = conditions()[0]
    scaled = Draw("strings.*.tilt_deg", "normal", 3.0, 5, ())
    got = instrument_of(replace(plain, draws=(scaled,))).resolved["strings"]
    before = instrument_of(plain).resolved["strings"]
    for name in before:
        assert got[name]["tilt_deg"] - before[name]["tilt_deg"] == pytest.approx(float(scaled.values(1)[0]))
    for path, words in {"strings.*.title": "no 'title'", "body.plugin": "cannot vary"}.items():
        with pytest.raises(TonewoodError, match=words):
            instrument_of(replace(plain, draws=(replace(scaled, path=path),)))


def test_own_values_are_those_of_the_resolved_bundle() -> None:
    low, _ = conditions()
    parameters = instrument_of(low).resolved
    first = next(iter(parameters["strings"].values()))
    assert ENGINE.own_value(low, "strings.A2.tilt_deg") == parameters["strings"]["A2"]["tilt_deg"]
    assert ENGINE.own_value(low, "strings.*.loss.eta_a") == first["loss"]["eta_a"]
    changed = replace(low, overrides={**low.overrides, "strings.A2.tilt_deg": 12.5})
    assert ENGINE.own_value(changed, "strings.A2.tilt_deg") == 12.5
    assert ENGINE.own_value(low, "render.fs") == low.render.fs
    assert ENGINE.own_value(low, "strings.A2.tilt_deg.more") is None
    assert ENGINE.own_value(low, "strings.H9.tilt_deg") is None


def test_the_time_of_a_render_is_predicted_from_a_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that gives 2 s to the assembly and 1 s to a piece of 0.25 s: 2 s + 4 s per second of sound."""
    times = iter([10.0, 12.0, 13.0])

    class Clock:
        def perf_counter(self) -> float:
            return next(times)

    monkeypatch.setattr(rendering, "_COSTS", {})
    monkeypatch.setattr(rendering, "time", Clock())
    low, _ = conditions(render={"output": "bridge", "tail": {"energy_db": -40, "cap": 0.3}})
    assert ENGINE.predict(low) == pytest.approx(2.0 + 4.0 * (0.3 + 0.5 * 0.3))
    short = replace(low, render=low.render.model_copy(update={"max_duration": 0.1}))
    assert ENGINE.predict(short) == pytest.approx(2.0 + 4.0 * 0.1)  # nothing is measured again


def test_a_batch_on_a_real_instrument(tmp_path: Path) -> None:
    levels = {"low": {"scale": 1.0}, "high": {"scale": 30}, "wrong": "loud"}
    factors = {"loss": {"path": "strings.*.loss.eta_a", "levels": levels}}
    path = tmp_path / "batch.yaml"
    path.write_text(json.dumps(manifest(factors=factors, pages=[{"type": "html"}], output={"formats": ["json"]})))
    report = run_batch(path, tmp_path / "out", ENGINE)
    assert [f.name for f in report.faults] == ["guitar.note.loss=wrong"]
    assert "strings.E2.loss" in report.faults[0].reason
    assert len(report.files) == 2
    row = json.loads((tmp_path / "out" / "manifest.json").read_text())["files"][0]
    assert row["identity"]["isa"]
    assert row["identity"]["parameters"]["name"] == "classical_guitar"
    assert row["lufs"] == pytest.approx(-23.0 - row["page_drop_db"], abs=0.02)


@pytest.mark.slow
def test_a_record_tells_how_far_the_energy_balance_closes() -> None:
    short = {"output": "bridge", "tail": {"energy_db": -40, "cap": 0.3}, "fs": 16000}
    reported, *_ = conditions(render=short | {"energy": True})
    plain, *_ = conditions(render=short)
    rendered, same = ENGINE.render(reported), ENGINE.render(plain)
    assert np.array_equal(rendered.samples, same.samples)
    assert rendered.info["energy"]["peak_J"] > 0
    assert rendered.info["energy"]["worst_residual"] <= 1e-10
    assert "energy" not in same.info


def test_another_instruction_set_is_refused() -> None:
    here = ENGINE.identity(conditions()[0])["isa"]
    other = "neon" if here != "neon" else "avx2"
    (asked, _) = conditions(render={"isa": other})
    with pytest.raises(TonewoodError, match=rf"render\.isa: {other} is asked for, this process runs {here}"):
        ENGINE.identity(asked)


def computed(**changes: Any) -> Any:
    """In place of `rendering.computed_with`: as here, but for `changes`."""
    here = rendering.computed_with()
    return lambda: here | changes


@pytest.mark.parametrize("what", ["kernel", "blas", "numpy", "scipy", "simd", "libc"])
def test_the_key_follows_what_computes(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    (condition, _) = conditions()
    before = ENGINE.identity(condition)
    assert what in before["computed_with"]
    monkeypatch.setattr(rendering, "computed_with", computed(**{what: "another"}))
    assert content_key(ENGINE.identity(condition)) != content_key(before)


@pytest.mark.slow
def test_another_core_of_blas_is_another_key() -> None:
    code = "from tonewood.workshop.batch.rendering import computed_with; print(computed_with()['blas'])"
    reported = [
        subprocess.run([sys.executable, "-c", code], env=os.environ | {"OPENBLAS_CORETYPE": core}, capture_output=True,
                       text=True, check=True).stdout
        for core in ("Prescott", "Prescott", "Nehalem")
    ]  # fmt: skip
    if "openblas" not in reported[0]:
        pytest.skip(f"OPENBLAS_CORETYPE is for OpenBLAS, here is {reported[0]}")
    assert reported[0] == reported[1] != reported[2]


def test_renders_of_another_library_are_reported_and_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "batch.yaml"
    short = {"output": "bridge", "tail": {"energy_db": -40, "cap": 0.1}, "fs": 16000}
    path.write_text(json.dumps(manifest(render=short, pages=[{"type": "html"}], output={"formats": ["json"]})))
    first = run_batch(path, tmp_path / "out", ENGINE)
    assert not any("are not used" in note for note in first.notes)
    monkeypatch.setattr(rendering, "computed_with", computed(scipy="another"))
    again = run_batch(path, tmp_path / "out", ENGINE)
    assert any(note.startswith("2 renders in ") and "are not used" in note for note in again.notes)
    assert again.rendered == 2
