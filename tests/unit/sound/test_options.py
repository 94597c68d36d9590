"""Options of a render: declared once, and the same for Python, the command line and batches."""

from __future__ import annotations

import inspect
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from tonewood.cli import plan, play, render
from tonewood.cli.options import option_name
from tonewood.instrument.bundle.schema_table import parameter_table
from tonewood.sound.render.accuracy import LEVELS
from tonewood.sound.render.options import AccuracyName, choices, limits
from tonewood.workshop.batch.manifest import RenderSettings

SCORE = tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0)])
#: fields that a command leaves out: render names files for the account of energy, a plan has no gain
LEFT_OUT = {render.render: {"energy"}, plan.plan: {"energy"}, play.play: {"energy"}}


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"fs": 7999}, "fs: is 7999 Hz; 8000 to 768000 are allowed"),
        ({"fs": 24000.5}, "fs: is 24000.5 Hz; 8000 to 768000 are allowed"),
        ({"tail": "long"}, "tail: is 'long'; 0 to 3600 are allowed"),
        ({"tail_level_db": 3}, "tail_level_db: is 3 dB; -300 to -1 are allowed"),
        ({"max_duration": float("nan")}, "max_duration: is nan s; 1e-06 to 86400 are allowed"),
        ({"accuracy": "best"}, "accuracy: is 'best'; draft, standard, reference are allowed"),
        ({"oversampling": 0.3}, "oversampling: is 0.3; 0.25 to 16 in steps of 0.25 are allowed"),
        ({"oversampling": 17}, "oversampling: is 17 steps per frame; 0.25 to 16 are allowed"),
        ({"freq_limit": 0}, "freq_limit: is 0 Hz; 100 to 768000 are allowed"),
        ({"lead_in": -1}, "lead_in: is -1; auto or 0 to 60 s are allowed"),
        ({"budget_cents": 101}, "budget_cents: is 101 cents; 0 to 100 are allowed"),
        ({"effects": " , "}, "effects: is ' , '; auto, all, none or names are allowed"),
        ({"outputs": ""}, "outputs: is ''; names of output groups are allowed"),
        ({"gain": 3}, "gain: is not a known key; did you mean gain_db? allowed: fs, accuracy, oversampling"),
    ],
)
def test_what_is_not_allowed_is_said_in_one_line(given: dict[str, object], line: str) -> None:
    monochord = tw.load_instrument("monochord")
    for ask in (
        lambda: tw.RenderOptions(**given),  # type: ignore[arg-type]  # wrong on purpose
        lambda: tw.render(SCORE, monochord, **given),
        lambda: tw.plan(SCORE, monochord, **given),
        lambda: tw.play(SCORE, monochord, **given),
    ):
        with pytest.raises(tw.TonewoodError) as caught:
            ask()
        assert str(caught.value).startswith(line)


def test_numbers_of_numpy_and_names_in_one_text() -> None:
    options = tw.RenderOptions(fs=np.int64(24000), tail=np.float32(0.5), outputs="a, b", effects="frets")  # type: ignore[arg-type]  # other types on purpose
    assert (options.fs, options.tail, options.outputs, options.effects) == (24000, 0.5, ("a", "b"), ("frets",))
    assert tw.RenderOptions(effects="none").effects == "none"


def test_names_that_are_blank_are_none() -> None:
    """A list of blanks is one of no names, which is refused like an empty text; blanks between names are left out."""
    for given in (["", " "], []):
        with pytest.raises(tw.TonewoodError, match=r"^outputs: is \(\); names of output groups are allowed"):
            tw.RenderOptions(outputs=given)  # type: ignore[arg-type]  # a list on purpose
    assert tw.RenderOptions(effects=[" a ", ""]).effects == ("a",)  # type: ignore[arg-type]
    assert tw.RenderOptions(outputs=" b ,, c").outputs == ("b", "c")  # type: ignore[arg-type]
    for key in ("outputs", "effects"):
        with pytest.raises(tw.TonewoodError, match=f"^{key}: is ''"):
            tw.RenderOptions(**{key: ""})  # type: ignore[arg-type]


def test_single_settings_go_before_those_of_options() -> None:
    options = tw.RenderOptions(fs=16000, max_duration=0.02, gain_db=-6.0)
    monochord = tw.load_instrument("monochord")
    audio = tw.render(SCORE, monochord, options=options)
    assert (audio.fs, len(audio.samples)) == (16000, 320)
    longer = tw.render(SCORE, monochord, 24000, options=options, max_duration=0.04)
    assert (longer.fs, len(longer.samples)) == (24000, 960)
    loud = tw.render(SCORE, monochord, options=options, gain_db=0.0)
    np.testing.assert_allclose(loud.samples, audio.samples * 10 ** (6 / 20), rtol=1e-12)


def test_a_tail_object_is_still_understood_and_deprecated() -> None:
    with pytest.warns(DeprecationWarning, match="tail_level_db"):
        options = tw.RenderOptions(tail=tw.Tail(-40.0, 2.0))  # type: ignore[arg-type]  # the way of version 0.1
    assert (options.tail, options.tail_level_db) == (2.0, -40.0)


@pytest.mark.parametrize("command", LEFT_OUT, ids=lambda c: c.__name__)
def test_commands_have_every_option_with_its_default(command: object) -> None:
    parameters = inspect.signature(command).parameters  # type: ignore[arg-type]  # a function
    for name, field in tw.RenderOptions.model_fields.items():
        if name in LEFT_OUT[command]:  # type: ignore[index]  # one of its keys
            assert name not in parameters or name == "energy"
            continue
        (option,) = parameters[name].annotation.__metadata__
        assert option.default == option_name(name)  # as typer keeps the first name in an annotation
        assert option.help.startswith(field.description)
        default = parameters[name].default
        assert default == field.default or float(default) == field.default


def test_a_batch_has_every_option_and_its_limits_are_no_wider() -> None:
    for name, field in tw.RenderOptions.model_fields.items():
        own, whole = limits(RenderSettings.model_fields[name]), limits(field)
        assert (own is None) == (whole is None)
        assert own is None or (own[0] >= whole[0] and own[1] <= whole[1])  # type: ignore[index]  # both or none
    assert set(RenderSettings.model_fields) - set(tw.RenderOptions.model_fields) == {"isa"}


def test_every_accuracy_has_its_settings() -> None:
    assert list(LEVELS) == choices(AccuracyName)


def test_no_warning_where_nothing_is_deprecated() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tw.RenderOptions(tail=1.0)


def test_the_reference_lists_every_option() -> None:
    """Mended by the output of `parameter_table`."""
    page = Path(__file__).parents[3] / "docs" / "reference" / "rendering.md"
    assert parameter_table(tw.RenderOptions) in page.read_text(encoding="utf-8")


def test_options_alone_are_light() -> None:
    script = "import sys, tonewood.sound.render.options; print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "tonewood.performance.engine.engine"} & set(loaded)


def test_the_deprecated_tail_has_the_defaults_of_its_options() -> None:
    defaults = tw.RenderOptions()
    assert (tw.Tail().cap, tw.Tail().level_db) == (defaults.tail, defaults.tail_level_db) == (10.0, -60.0)
