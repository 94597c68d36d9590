"""Plugins that break the contract, method by method: one line that names the class and the key, never a traceback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mido
import pytest
from ruamel.yaml import YAML

from tonewood.cli.main import run

HEAD = """
import dataclasses

import numpy as np
import tonewood.authoring as ta


class P(ta.Parameters):
    '''Of the part.'''
"""
#: a plugin of each kind that keeps the contract: lines of its class
WHOLE: dict[str, tuple[str, dict[str, str]]] = {
    "strings.A2": (
        "Resonator",
        {
            "length": "@property\ndef length(self):\n    return 0.9",
            "tension": "@property\ndef tension(self):\n    return 58.8",
            "eta": "def eta(self, omega, k, tension=None):\n    return 2.0 / omega",
            "basis": "def basis(self, freq_upper, *, stop=0.0, tension=None):\n"
            "    return ta.string_basis(0.9 - stop, tension or 58.8, 1.5e-3, 0.0, self.eta, freq_upper=freq_upper)",
            "detuned": "def detuned(self, basis, tension):\n    return ta.string_detuned(basis, tension, self.eta)",
            "transfer": "def transfer(self, a, b):\n    return ta.string_transfer(a, b)",
        },
    ),
    "body": (
        "Body",
        {
            "points": "def points(self):\n    return {'bridge': ta.BodyPoint((0.0, 0.0, 1.0))}",
            "basis": "def basis(self, f):\n    return ta.ModalBasis.real([1200.0], [20.0], {'bridge': [1.0]})",
        },
    ),
    "exciters.pluck": (
        "Exciter",
        {
            "gesture": "def gesture(self, event, place):\n"
            "    return ta.Gesture(ta.smooth_step(-0.01, 0.0, 0.0, 1.0) + ta.smooth_step(0.0, 1e-3, 1.0, 0.0), 0.1)",
        },
    ),
    "connections.felt": (
        "Attachment",
        {
            "attach": "def attach(self, name, site):\n"
            "    at, law = f'{name}.at', ta.HardeningSpring(0.0, 1e9)\n"
            "    terms = site.motion(at, (0.0, 0.0, 1.0))\n"
            "    return ta.Attached({at: 0.3}, connections=(ta.Connection(f'{site.string}.{at}', terms, law),))",
        },
    ),
    "outputs.bridge": (
        "Pickup",
        {
            "channels": "@property\ndef channels(self):\n    return ('a',)",
            "unit": "@property\ndef unit(self):\n    return 'm/s'",
            "rows": "def rows(self, name, scene):\n"
            "    return ta.PickupRows((ta.Readout(name, 'velocity', (ta.Term('body', 'bridge'),)),))",
        },
    ),
}
EFFECT = {
    "next_watch": "def next_watch(self, sample, switching):\n    return ta.next_multiple(sample, 1)",
    "watch": "def watch(self, moment, switching):\n    return ta.Watched(frozenset(self.components))",
}


def indented(lines: str) -> str:
    return "\n".join(f"    {line}" for line in lines.split("\n"))


def code(key: str, changes: dict[str, str], effect: dict[str, str] | None = None) -> str:
    """The file of a plugin with some methods in place of its own; an empty one leaves it out."""
    base, methods = WHOLE[key]
    body = "\n\n".join(indented(lines) for lines in {**methods, **changes}.values() if lines)
    out, effects = HEAD, ""
    if effect is not None:
        watched = "\n\n".join(indented(lines) for lines in {**EFFECT, **effect}.values() if lines)
        out += f"\n\nclass FeltEffect(ta.SwitchedConnections):\n    '''An effect.'''\n\n{watched}\n"
        effects = (
            "    effects = (ta.Effect('felt', 'a spring', 'additive', 'always', 'a bound', cost=lambda n: 1.0, "
            "runtime=FeltEffect),)\n"
        )
    return (
        out + f"\n\nclass Odd(ta.{base}[P]):\n    '''A part.'''\n\n    api = 1\n    Parameters = P\n{effects}\n{body}\n"
    )


def bundle(folder: Path, key: str, text: str) -> Path:
    """A string on one mode, with that plugin in one place and built-in ones in all others."""
    target = folder / "odd"
    target.mkdir()
    (target / "odd.py").write_text(text)
    (target / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n200,25,0.6,1\n")
    values: dict[str, Any] = {
        "schema": "tonewood-instrument/2", "name": "odd", "title": "odd", "licence": "CC0-1.0", "sources": {},
        "provenance": {"*": {"kind": "authored"}},
        "body": {"plugin": "modal_table", "table": "body.csv", "shapes": "points",
                 "points": {"bridge": {"direction": "z"}}},
        "strings": {"A2": {"plugin": "stiff_string", "note": "A2", "end": "body.bridge", "freq_upper": 2000.0,
                           "length": 0.9, "tension": 58.8, "linear_density": 1.5e-3,
                           "loss": {"law": "sigma", "sigma0": 1.0}}},
        "stops": {"kind": "frets", "count": 2},
        "exciters": {"pluck": {"plugin": "force_pulse", "at": "body.bridge", "duration": 1e-3}},
        "playing": {"velocity": {"parameter": "pluck.force", "low": 0.4, "high": 4.0}},
        "outputs": [{"name": "bridge", "plugin": "point_pickup", "quantity": "velocity", "at": "body.bridge",
                     "full_scale": 1.0}],
    }  # fmt: skip
    kind, _, name = key.partition(".")
    own: dict[str, Any] = {"plugin": "odd.py:Odd"}
    if kind == "strings":
        values["strings"][name] = own | {"note": "A2", "end": "body.bridge", "freq_upper": 2000.0}
    elif kind == "body":
        values["body"] = own
    elif kind == "outputs":
        values["outputs"] = [own | {"name": name, "full_scale": 1.0}]
    elif kind == "exciters":
        values["exciters"] = {"first": values["exciters"]["pluck"], name: own}
        values["playing"] = {"velocity": {"parameter": "first.force", "low": 0.4, "high": 4.0}, "exciter": name}
    else:
        values[kind] = {name: own}
    with (target / "instrument.yaml").open("w") as stream:
        YAML().dump(values, stream)
    return target


def checked(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as ended:
        run(["check", str(folder), "--allow-code", "--fs", "16000"])
    return ended.value.code, *capsys.readouterr()


#: an exception whose own text raises another
UNTOLD = """@property
def length(self):
    class E(Exception):
        def __str__(self):
            raise RuntimeError("none")
    raise E"""
#: a bank of a pickup that gains energy
GROWING = """def rows(self, name, scene):
    own = f"{name}.bank"
    bank = ta.ModalBasis.real([1e3], [-5.0], {"in": [1.0]})
    return ta.PickupRows((ta.Readout(name, "velocity", (ta.Term(own, "in"),)),), components={own: bank})"""


def felt(place: str, at: str = "f'{name}.at'", law: str = "ta.Contact(1e6, 1.5, offset=-1e-5)") -> str:
    """A contact at a place of the string, m."""
    return f"""def attach(self, name, site):
    at = {at}
    touch = ta.Connection(f"{{site.string}}.{{at}}", site.motion(at, (0.0, 0.0, 1.0)), {law})
    return ta.Attached({{at: {place}}}, connections=(touch,))"""


def of_function(function: str) -> str:
    """The rows of a pickup, of which a function of x makes the channel."""
    return f"""def rows(self, name, scene):
    readouts = (ta.Readout(name, "velocity", (ta.Term("body", "bridge"),)),)
    return ta.PickupRows(readouts, conversion=ta.Conversion(function=lambda x: {function}))"""


def cases() -> list[tuple[str, str, str, str]]:
    """Key, method, its lines, words of the error."""
    out = []
    for key, (_, methods) in WHOLE.items():
        for name, lines in methods.items():
            if name == "eta":
                continue
            head = lines[: lines.index(":\n") + 1]
            needed = "linear_density, loss" if (key, name) == ("strings.A2", "basis") else name  # or modes of its own
            out.append((key, name, "", f"leaves out {needed}"))
            out.append(
                (key, name, f"{head}\n    raise KeyError('odd')", f"Odd.{name} raises KeyError: 'odd' (odd.py, line")
            )
            out.append((key, name, f"{head}\n    return self.missing", f"Odd.{name} raises AttributeError: "))
            for value in ("None", "'text'", "float('nan')"):
                may_be = {"unit": ("'text'",), "channels": ()}.get(name, ())
                if value not in may_be:
                    out.append((key, name, f"{head}\n    return {value}", f"Odd.{name} returns"))
            if name not in ("length", "tension", "channels", "unit"):
                out.append((key, name, f"{name} = 3", f"{name} is an int; a method is wanted"))
            else:
                out.append(
                    (key, name, f"def {name}(self):\n    return 1.0", f"{name} is a method; a property is wanted")
                )
    own = "ta.string_basis(0.9 - stop, tension or 58.8, 1.5e-3, 0.0, self.eta, freq_upper=freq_upper)"
    made = "def basis(self, freq_upper, *, stop=0.0, tension=None):\n    b = " + own + "\n    return "
    real = "def basis(self, freq_upper, *, stop=0.0, tension=None):\n    return ta.ModalBasis.real({})"
    out += [
        (
            "strings.A2",
            "length",
            "@property\ndef length(self):\n    return -1.0",
            "returns -1.0; a number of metres above 0",
        ),
        ("strings.A2", "basis", "def basis(self, freq):\n    return None", "Odd.basis raises TypeError"),
        ("strings.A2", "basis", real.format("[300.0, 600.0], [1.0, 1.0], {'bridge': [1.0, 1.0]}"), "without `shape`"),
        ("strings.A2", "basis", real.format("[300.0, 600.0], [1.0, 1.0], {'nut': [1.0, 1.0]}"), "'bridge' is wanted"),
        ("strings.A2", "basis", made + "ta.retuned(b, np.sqrt(b.stiffness), -b.damping_rate)", "a damping rate of -"),
        ("strings.A2", "basis", made.replace("=freq_upper", "=3e6"), "27274 modes below 3e+06 Hz; at most 3000"),
        ("strings.A2", "basis", real.format("np.arange(1.0, 3002), 1.0, {'bridge': 1.0}"), "3001 modes; at most 3000"),
        (
            "strings.A2",
            "basis",
            made + "dataclasses.replace(b, residual=np.full_like(b.residual, np.nan))",
            "residual of a basis must be finite",
        ),
        (
            "strings.A2",
            "detuned",
            "def detuned(self, basis, tension):\n    return basis.select(np.arange(2))",
            "as many modes",
        ),
        (
            "strings.A2",
            "transfer",
            "def transfer(self, a, b):\n    return np.zeros((1, 1)), np.zeros((1, 1))",
            "Odd.transfer returns displacement of shape (1, 1)",
        ),
        (
            "strings.A2",
            "transfer",
            "def transfer(self, a, b):\n    d, v = ta.string_transfer(a, b)\n    return np.nan * d, v",
            "numbers that are not finite",
        ),
        (
            "strings.A2",
            "x",
            "def potentials(self, string):\n    return 1.0",
            "Odd.potentials returns 1.0",
        ),
        ("strings.A2", "x", "@property\ndef longitudinal(self):\n    return 1", "a ta.Longitudinal or None is wanted"),
        ("strings.A2", "x", "def potentials(self, string):\n    return [1]", "a ta.Potential is wanted"),
        ("strings.A2", "x", "def decay_rate(self, freq_rad, tension):\n    return -freq_rad", "Odd.decay_rate returns"),
        (
            "body",
            "basis",
            "def basis(self, f):\n    return ta.ModalBasis.real([1e3], [2.0], {'top': [1.0]})",
            "a basis with the point 'bridge'",
        ),
        (
            "body",
            "points",
            "def points(self):\n    return {'bridge': ta.BodyPoint((0.0, 1.0))}",
            "three numbers is wanted",
        ),
        (
            "exciters.pluck",
            "gesture",
            "def gesture(self, e, place):\n    return ta.Gesture((), ta.Fraction(fraction=0.2))",
            "a number of metres (ta.metres) or None is wanted",
        ),
        (
            "exciters.pluck",
            "gesture",
            "def gesture(self, e, place):\n    return ta.Gesture((1, 2), 0.1)",
            "segments 1; a ta.Segment is wanted",
        ),
        (
            "exciters.pluck",
            "gesture",
            "def gesture(self, e, place):\n    return ta.Gesture((), 0.1, on='nowhere')",
            "Odd.gesture: on names 'nowhere'",
        ),
        ("exciters.pluck", "x", "at = property(lambda self: 3)", "Odd.at returns 3"),
        ("exciters.pluck", "x", "def attach(self, name, site):\n    return 3", "Odd.attach returns 3; a ta.Attached"),
        (
            "connections.felt",
            "attach",
            "def attach(self, name, site):\n    return ta.Attached({'at': ta.Fraction(fraction=0.3)})",
            "places['at'] Fraction(fraction=0.3); a number of metres",
        ),
        (
            "connections.felt",
            "attach",
            "def attach(self, name, site):\n    t = (ta.Term('nobody', 'at', 1.0),)\n"
            "    return ta.Attached({'at': 0.3}, connections=(ta.Connection('A2.at', t, ta.SpringDashpot()),))",
            "there is no component 'nobody'",
        ),
        (
            "connections.felt",
            "attach",
            "def attach(self, name, site):\n    t = site.motion('elsewhere', (0.0, 0.0, 1.0))\n"
            "    return ta.Attached({'at': 0.3}, connections=(ta.Connection('A2.at', t, ta.SpringDashpot()),))",
            "A2.z has no point 'elsewhere'",
        ),
        (
            "connections.felt",
            "attach",
            "def attach(self, name, site):\n    t = site.motion('at', (0.0, 0.0, 1.0))\n"
            "    n = f'A2.{site.length:.2f}'\n"
            "    return ta.Attached({'at': 0.3}, connections=(ta.Connection(n, t, ta.SpringDashpot(1.0)),))",
            "Odd.attach returns other connections at stop 2",
        ),
        (
            "outputs.bridge",
            "rows",
            "def rows(self, name, scene):\n    return ta.PickupRows(())",
            "0 readouts; one for each",
        ),
        (
            "outputs.bridge",
            "rows",
            "def rows(self, name, scene):\n"
            "    return ta.PickupRows((ta.Readout(name, 'velocity', (ta.Term('neck', 'bridge'),)),))",
            "there is no component 'neck'",
        ),
        (
            "outputs.bridge",
            "rows",
            "def rows(self, name, scene):\n"
            "    return ta.PickupRows((ta.Readout(name, 'velocity', (ta.Term('body', 'top'),)),))",
            "body has no point 'top'",
        ),
        (
            "outputs.bridge",
            "rows",
            "def rows(self, name, scene):\n    return ta.PickupRows((ta.Readout(name, 'speed', ()),))",
            "Odd.rows raises ValueError: a readout's quantity",
        ),
        (
            "outputs.bridge",
            "rows",
            "def rows(self, name, scene):\n"
            "    return ta.PickupRows((ta.Readout(name, 'force', forces=(('A2', 1.0),)),))",
            "there is no connection 'A2'",
        ),
    ]
    out += [
        (
            "strings.A2",
            "eta",
            "def eta(self, omega, k, tension=None):\n    return 2.0 / omega + 0j",
            "eta must be real",
        ),
        (
            "strings.A2",
            "eta",
            "def eta(self, omega, k, tension=None):\n    omega *= 2.0\n    return 2.0 / omega",
            "Odd.basis raises ValueError: output array is read-only (odd.py, line|Odd.eta raises",
        ),
        ("strings.A2", "length", UNTOLD, "Odd.length raises E (odd.py, line"),
        ("connections.felt", "attach", felt("-0.1"), "'felt.at' on string A2 -0.1 m from the bridge; 0 to 0.9 m"),
        ("connections.felt", "attach", felt("3.0"), "'felt.at' on string A2 3 m from the bridge; 0 to 0.9 m"),
        (
            "connections.felt",
            "attach",
            felt("0.3", at="'pluck'"),
            "'pluck' on string A2, which has a point of this name",
        ),
        ("connections.felt", "attach", felt("0.3", at="'bridge'"), "'bridge' on string A2, which has a point of this"),
        ("outputs.bridge", "rows", of_function("np.where(x == 0.0, 0.0, np.nan)"), "small readouts are not finite"),
        (
            "outputs.bridge",
            "rows",
            of_function("x if len(x) == 1 else x[:-1]"),
            "an array (3, 1) of real numbers is wanted",
        ),
        ("outputs.bridge", "rows", of_function("x if len(x) == 1 else 1 / 0"), "it raises ZeroDivisionError"),
        ("outputs.bridge", "rows", of_function("x - x.mean()"), "of a row and of its neighbours"),
        ("outputs.bridge", "rows", GROWING, "components['bridge.bank'] a basis of which a mode grows at 5 1/s"),
    ]
    return out


@pytest.mark.parametrize(("key", "method", "lines", "said"), cases())
def test_a_broken_method_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, method: str, lines: str, said: str
) -> None:
    status, out, err = checked(bundle(tmp_path, key, code(key, {method: lines})), capsys)
    assert status == 2, out
    assert out == ""
    assert err.startswith("tonewood: ")
    assert err.count("\n") == 1
    assert any(words in err for words in said.split("|")), err
    assert "Odd" in err
    assert key in err or "odd.py:Odd" in err


@pytest.mark.parametrize(
    ("method", "lines", "said"),
    [
        ("watch", "", "its effect 'felt' (FeltEffect) leaves out watch|FeltEffect leaves out watch"),
        ("next_watch", "", "FeltEffect leaves out next_watch"),
        (
            "watch",
            "def watch(self, moment, switching):\n    return 3",
            "FeltEffect.watch returns 3; a ta.Watched or None",
        ),
        (
            "watch",
            "def watch(self, moment, switching):\n    return ta.Watched(frozenset('Z'))",
            "wanted 'Z'; one of A2",
        ),
        (
            "watch",
            "def watch(self, moment, switching):\n    return ta.Watched(frozenset(), [('A2', 1.0, True)])",
            "bounds ('A2', 1.0, True); (component, ta.Bound",
        ),
        (
            "watch",
            "def watch(self, moment, switching):\n    raise ZeroDivisionError",
            "FeltEffect.watch raises ZeroDivision",
        ),
        (
            "next_watch",
            "def next_watch(self, sample, switching):\n    return sample",
            "FeltEffect.next_watch returns 0",
        ),
        (
            "next_watch",
            "def next_watch(self, sample, switching):\n    return None",
            "FeltEffect.next_watch returns None",
        ),
        ("next_watch", "def next_watch(self, sample, switching):\n    return sample + 5", "a multiple of 64"),
        ("apply", "def apply(self, system, on, frettings):\n    return None", "FeltEffect.apply returns None"),
        ("cost", "def cost(self, moment, component, on):\n    return float('nan')", "FeltEffect.cost returns nan"),
        ("load", "def load(self, component):\n    return 'much'", "FeltEffect.load returns 'much'"),
        ("report", "def report(self, usage):\n    return None", "FeltEffect.report returns None"),
        ("start", "def start(self):\n    return None", "FeltEffect.start returns None"),
        ("__init__", "def __init__(self, model):\n    pass", "effect 'felt': FeltEffect raises TypeError"),
    ],
)
def test_a_broken_effect_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, lines: str, said: str
) -> None:
    key = "connections.felt"
    status, out, err = checked(bundle(tmp_path, key, code(key, {}, {method: lines})), capsys)
    assert status == 2, out
    assert err.count("\n") == 1
    assert any(words in err for words in said.split("|")), err
    assert key in err or "odd.py:Odd" in err


@pytest.mark.parametrize("key", WHOLE)
def test_a_whole_one_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str) -> None:
    effect = {} if key.startswith("connections") else None
    status, out, err = checked(bundle(tmp_path, key, code(key, {}, effect)), capsys)
    assert status == 0, err
    assert out.endswith("ok\n")


def gesture(noise: str) -> str:
    return f"def gesture(self, e, place):\n    return ta.Gesture((), 0.1, noise=ta.SampledForce({noise}))"


def rows(made: str) -> str:
    readout = "r = ta.Readout(name, 'velocity', (ta.Term('body', 'bridge'),))"
    return f"def rows(self, name, scene):\n    {readout}\n    return ta.PickupRows({made})"


def converted(made: str) -> str:
    return rows(f"(r,), conversion=ta.Conversion({made})")


def attached(made: str) -> str:
    terms = "t = site.motion('at', (0.0, 0.0, 1.0))"
    return f"def attach(self, name, site):\n    {terms}\n    return ta.Attached({{'at': 0.3}}, {made})"


def with_law(made: str) -> str:
    return attached(f"connections=(ta.Connection('A2.at', t, {made}),)")


LONG = "def gesture(self, e, place):\n    return ta.Gesture((ta.Segment(0.0, 1e12, 1.0, 0.0, 0.0),))"
PLACE = "def attach(self, name, site):\n    return ta.Attached({'at': 10**400})"


@pytest.mark.parametrize(
    ("key", "lines", "said"),
    [
        ("exciters.pluck", gesture("0.0, float('nan'), np.zeros(5)"), "noise.interval nan"),
        ("exciters.pluck", gesture("None, 1e-4, np.zeros(5)"), "noise.start None"),
        ("exciters.pluck", gesture("0.0, 1e-4, np.zeros(0)"), "an array (n,) of one or more real"),
        ("exciters.pluck", gesture("0.0, 1e-4, np.zeros((2, 2))"), "an array (n,) of one or more real"),
        ("exciters.pluck", gesture("0.0, 1e-4, np.array(['a'])"), "an array (n,) of one or more real"),
        ("exciters.pluck", gesture("-1e6, 1e-4, np.zeros(5)"), "times of at most 3600 s"),
        ("exciters.pluck", LONG, "times of at most 3600 s"),
        ("exciters.pluck", "def gesture(self, e, place):\n    raise SystemExit(3)", "raises SystemExit: 3"),
        ("outputs.bridge", "channels = 3", "channels is 3; a tuple of one or more names"),
        ("outputs.bridge", "unit = None", "unit is None; a unit, as text,"),
        ("outputs.bridge", rows("(ta.Readout(name, 'velocity', 3),)"), "Odd.rows returns a PickupRows that cannot be"),
        ("outputs.bridge", rows("(r,), components=3"), "that cannot be used: it raises AttributeError"),
        ("outputs.bridge", rows("(r,), components={'body': ta.loose_mass(1.0)}"), "two components 'body'"),
        ("outputs.bridge", rows("(ta.Readout(name, 'velocity', (ta.Term([], 'bridge'),)),)"), "[]; the name of a"),
        ("outputs.bridge", rows("(ta.Readout(name, 'force', forces=(([], 1.0),)),)"), "a pair (connection, factor)"),
        ("outputs.bridge", converted("function=lambda x: 1 / 0"), "it raises ZeroDivisionError"),
        ("outputs.bridge", converted("circuit='ab'"), "a ta.Circuit or None"),
        ("outputs.bridge", converted("circuit=ta.Circuit((), ())"), "numerator (); a tuple of numbers"),
        ("outputs.bridge", converted("circuit=ta.Circuit((1.0,), (0.0,))"), "a first coefficient other than 0"),
        ("outputs.bridge", converted("circuit=ta.Circuit((np.nan,), (1.0,))"), "nan; a finite number"),
        ("connections.felt", with_law("None"), "law None; a law, as ta.Contact"),
        ("connections.felt", with_law("ta.Contact"), "a law, as ta.Contact"),
        ("connections.felt", with_law("ta.Contact(1e300, 1.5)"), "law: stiffness 1e+300; a number from"),
        ("connections.felt", with_law("ta.Contact(1e6, 1.5, offset=1e300)"), "law: offset 1e+300; a number from"),
        ("connections.felt", PLACE, "a number of metres from the bridge"),
        ("connections.felt", attached("components={'body': ta.loose_mass(1e-3)}"), "there are two components 'body'"),
    ],
)
def test_a_part_of_a_result_that_cannot_be_used_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, lines: str, said: str
) -> None:
    method = lines.removeprefix("def ").replace(" ", "(").partition("(")[0]
    status, out, err = checked(bundle(tmp_path, key, code(key, {method: lines})), capsys)
    assert status == 2, out
    assert err.count("\n") == 1, err
    assert said in err


def test_a_loss_factor_of_no_string_is_refused_before_it_costs_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A law that forgets to divide by omega; numbers that overflow do not warn besides."""
    for eta in ("omega", "1e300 + 0 * omega"):
        law = HEAD + "\n\nclass Odd(ta.Loss[P]):\n    '''A law.'''\n\n    api = 1\n    Parameters = P\n\n"
        law += f"    def eta(self, omega, k, string):\n        return {eta}\n"
        (tmp_path / eta[:2]).mkdir()
        folder = bundle(tmp_path / eta[:2], "outputs.bridge", code("outputs.bridge", {}))
        (folder / "law.py").write_text(law)
        manifest = folder / "instrument.yaml"
        manifest.write_text(manifest.read_text().replace("law: sigma", "law: law.py:Odd").replace("sigma0: 1.0", ""))
        status, _, err = checked(folder, capsys)
        assert status == 2
        assert err.count("\n") == 1, err
        assert "2 sigma / omega, and at most 100 is allowed" in err


@pytest.mark.parametrize(
    ("sounding", "said"),
    [
        ("1 / 0", "conversion.function raises ZeroDivisionError"),
        ("exit(3)", "conversion.function raises SystemExit: 3"),
        ("None", "conversion.function returns object of shape ()"),
        ("x * 1j", "conversion.function returns complex128 of shape"),
    ],
)
def test_a_conversion_that_fails_while_it_sounds_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], sounding: str, said: str
) -> None:
    lines = converted(f"function=lambda x: ({sounding}) if len(x) > 3 else x")
    folder = bundle(tmp_path, "outputs.bridge", code("outputs.bridge", {"rows": lines}))
    score, sound = tmp_path / "a.mid", tmp_path / "a.wav"
    track = mido.MidiTrack(mido.Message(kind, note=45, time=t) for kind, t in (("note_on", 0), ("note_off", 200)))
    mido.MidiFile(tracks=[track]).save(score)
    with pytest.raises(SystemExit) as ended:
        run(["render", str(score), "-i", str(folder), "-o", str(sound), "--allow-code", "--max-duration", "0.1"])
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.count("\n") == 1, err
    assert "outputs.bridge" in err
    assert said in err
    assert not sound.exists()


@pytest.mark.parametrize(
    ("fault", "said"), [("SystemExit(3)", "ended the program: SystemExit(3)"), ("MemoryError('8 GB')", "memory: 8 GB")]
)
def test_code_that_ends_the_program_or_takes_all_memory_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str, said: str
) -> None:
    """Outside of the methods of the contract, too: here where parameters are made."""
    lines = indented(f"def model_post_init(self, context):\n    raise {fault}")
    text = code("outputs.bridge", {}).replace("'''Of the part.'''", f"'''Of the part.'''\n\n{lines}")
    status, _, err = checked(bundle(tmp_path, "outputs.bridge", text), capsys)
    assert status == 2
    assert err.count("\n") == 1, err
    assert said in err


PUSHING = felt("0.3", law="ta.Contact(1e6, 1.5, offset=1e-3)")
STRING_BASIS, BODY_BASIS = WHOLE["strings.A2"][1]["basis"], WHOLE["body"][1]["basis"]


def counted(basis: str, number: str) -> str:
    """A basis in which a number grows by a ten-thousandth from call to call."""
    count = "    self.n = getattr(self, 'n', 0) + 1\n"
    return basis.replace("    return", count + "    return").replace(number, f"{number} * (1 + 1e-4 * self.n)")


@pytest.mark.parametrize(
    ("key", "method", "lines", "said"),
    [
        # 1e6 N/m^1.5 of 1 mm, and of nothing
        ("connections.felt", "attach", PUSHING, "connection A2.felt.at: pushes with 31.6 N"),
        ("connections.felt", "attach", PUSHING.replace("offset=1e-3", "offset=0.0"), None),
        # two semitones by tension alone: 2^(4 / 12) - 1
        ("strings.A2", "basis", STRING_BASIS.replace("0.9 - stop", "0.9"), "string A2: stop 2 is in tune at +26 %"),
        ("strings.A2", "basis", STRING_BASIS, None),
        ("strings.A2", "basis", counted(STRING_BASIS, "1.5e-3"), "string A2: its plugin's `basis` gives other modes"),
        ("body", "basis", counted(BODY_BASIS, "1200.0"), "body: its plugin's `basis` gives other modes"),
        ("body", "basis", BODY_BASIS, None),
    ],
)
def test_what_check_can_only_doubt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, method: str, lines: str, said: str | None
) -> None:
    """A wrong sign of an offset, a basis that does not know its stop and one with a state play without an error."""
    status, out, err = checked(bundle(tmp_path, key, code(key, {method: lines})), capsys)
    assert (status, err) == (0, "")
    if said is None:
        assert "warning" not in out
    else:
        assert f"warning: {said}" in out
