"""Curves of the laboratory's figures: against each other, where two ways lead to the same, and printed errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tonewood.lab.systems import (
    chinnakonda_plots,
    fabre_academic,
    fabre_guitar,
    fabre_methods,
    harp,
    klosner,
    string_and_body,
)
from tonewood.lab.systems.chinnakonda_problems import HEAVY, LIGHT, exact_driven, two_masses


def curves(axis) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Label -> x and y, of lines without a label by their number."""
    return {line.get_label(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in axis.lines}


@pytest.fixture
def drawn(monkeypatch):
    """Figures by name, in place of files."""
    made = {}

    def save(fig, path: Path) -> Path:
        made[path.name] = fig.axes
        return path

    for module in (chinnakonda_plots, fabre_academic, fabre_guitar, fabre_methods, harp, klosner, string_and_body):
        monkeypatch.setattr(module, "save", save)
    return made


def test_displacements_of_two_masses() -> None:
    axes = chinnakonda_plots._displacements().axes
    assert [a.get_title() for a in axes] == [f"mass {k}, {c} damping" for c in ("light", "very heavy") for k in (1, 2)]
    for axis in axes:
        lines = curves(axis)
        (t, exact), size = lines["exact"], np.abs(lines["exact"][1]).max()
        assert (t[0], t[-1], exact[0]) == (0.0, 5.0, 0.0)
        off = {}
        for name in ("P0", "P1"):
            x, y = lines[name]
            assert x == pytest.approx(np.arange(151) / 30)
            off[name] = np.abs(y - np.interp(x, t, exact)).max() / size
        assert off["P1"] < 0.02 < 3 * off["P1"] + 0.02 < off["P0"] + 0.02


def test_errors_of_two_masses_are_the_printed_ones() -> None:
    """Light damping, 20 steps per period: the thesis' system, to the digits given."""
    axes = chinnakonda_plots._errors().axes
    size = np.abs(exact_driven(two_masses(LIGHT), 1 / 240, 2401)[:, 0]).max()
    assert [list(curves(a)) for a in axes] == [["trapezoidal", "P1", "Simpson", "P2"], ["Simpson", "P2"]] * 2
    for axis, name, printed, rate in ((axes[0], "P1", 8.196e-3, 30), (axes[1], "P2", 1.837e-4, 15)):
        x, y = curves(axis)[name]
        assert x == pytest.approx(np.arange(10 * rate + 1) / rate)
        assert np.abs(y).max() / size == pytest.approx(printed, rel=5e-3)
    assert np.abs(curves(axes[2])["P1"][1]).max() < 0.5 * np.abs(curves(axes[0])["P1"][1]).max()


def test_convergence_is_drawn_over_damping_and_step(monkeypatch) -> None:
    monkeypatch.setattr(
        chinnakonda_plots, "relative_errors", lambda update, c, steps: update.order + c / np.array(steps)
    )
    damping, light, heavy = (curves(a) for a in chinnakonda_plots._convergence().axes)
    c, order = np.linspace(0.005, 1, 25) * HEAVY, {"P0": 1, "trapezoidal": 2, "P1": 2, "Simpson": 4, "P2": 4}
    steps = np.array([10, 20, 40, 80, 160, 320])
    for name, n in order.items():
        assert damping[name] == (pytest.approx(c / np.pi), pytest.approx(n + c / 20))
        for lines, at in ((light, LIGHT), (heavy, HEAVY)):
            assert lines[f"{name}, order {n}"] == (pytest.approx(1 / (1.5 * steps)), pytest.approx(n + at / steps))


def test_free_motions_and_indices() -> None:
    for axis, start in zip(chinnakonda_plots._initial_conditions().axes, (1.0, -1.0), strict=True):
        lines = curves(axis)
        (t, exact), (x, y) = lines["exact"], lines["P1"]
        assert (t[-1], x[-1], exact[0]) == (10.0, 10.0, start)
        assert y == pytest.approx(exact[::8], abs=1e-11)
    table = {1: {"a": 0.1, "b": 3.0}, 4: {"a": 0.5, "b": 2.0}}
    (axis,) = chinnakonda_plots._indices(table).axes
    assert {k: (x.tolist(), y.tolist()) for k, (x, y) in curves(axis).items()} == {
        "a": ([1, 4], [0.1, 0.5]),
        "b": ([1, 4], [3.0, 2.0]),
    }


def test_the_reduced_system_follows_mass_2() -> None:
    first, *others = chinnakonda_plots._stiff().axes
    one = curves(first)
    for axis, kind in zip(others, ("proportional", "non-proportional"), strict=True):
        lines = curves(axis)
        (t, exact), (x, small), (_, direct) = (lines[n] for n in ("exact", "P1 (reduced)", "HHT-alpha (-0.3)"))
        assert (t[-1], x[-1], exact[0]) == (5.0, 5.0, 10.0)
        at = exact[::200]
        assert np.abs(small - at).max() < 0.1 * np.abs(direct - at).max()
        assert np.abs(one[f"P1 (reduced), {kind}"][1]).max() < 2e-3
        assert one[f"exact, {kind}"][1][0] == one[f"HHT-alpha, {kind}"][1][0] == 1.0
        assert np.abs(one[f"HHT-alpha, {kind}"][1][20:]).max() < 0.02


def test_each_figure_has_its_file(drawn, monkeypatch) -> None:
    names = ["displacements", "errors", "convergence", "initial_conditions", "stiff", "indices"]
    for name in names:
        monkeypatch.setattr(
            chinnakonda_plots, f"_{name}", lambda *table, name=name: SimpleNamespace(axes=(name, *table))
        )
    paths = chinnakonda_plots.plots(Path("x"), {})
    assert paths == [Path("x") / f"chinnakonda_{name}.png" for name in names]
    assert [axes[0] for axes in drawn.values()] == names


def test_weinreich_s_pair_and_the_decay_of_a2(drawn) -> None:
    """Without a split one pole has all of the decay, 2 r; poles of the stepper lie on the closed forms."""
    string_and_body.plots(Path())
    pair, decay = drawn["string_and_body.png"]
    lines = list(curves(pair).values())
    split = np.linspace(0.0, 10.0, 41)
    root = np.sqrt(4.0 - split**2 / 4 + 0j)
    for first, within in ((0, 1e-12), (4, 0.1)):  # closed form; stepper, where the two meet
        decays, beats = (np.sort([y for _, y in lines[i : i + 2]], axis=0) for i in (first, first + 2))
        assert decays == pytest.approx(2.0 + np.array([-1, 1])[:, None] * root.real, abs=within)
        assert beats == pytest.approx(np.array([-1, 1])[:, None] * root.imag, abs=within)
    assert all(x == pytest.approx(split) for x, _ in lines)
    (n, exact), (_, at_48_khz), (_, rough) = curves(decay).values()
    assert n.tolist() == list(range(1, 31))
    assert at_48_khz == pytest.approx(exact, rel=0.01)
    assert rough == pytest.approx(exact, rel=0.3)


def test_the_academic_system_is_drawn_twice(drawn) -> None:
    fabre_academic.plots(Path())
    wave, spectrum = drawn["fabre_fig3_academic.png"]
    (t, exact), (_, complex_), (_, proportional) = curves(wave).values()
    assert t[-1] == pytest.approx(20.0, abs=0.01)
    assert complex_ == pytest.approx(exact, abs=0.01 * np.abs(exact).max())
    assert np.abs(proportional - exact).max() > 0.02 * np.abs(exact).max()
    (f, exact), (_, complex_), (_, proportional) = curves(spectrum).values()
    assert (f[0], f[-1]) == (0.2, 5.0)
    assert complex_ == pytest.approx(exact, abs=1e-3)
    assert len(drawn["fabre_fig4_shapes.png"]) == 10


def test_pole_errors_and_modes_needed_as_they_are(drawn, monkeypatch) -> None:
    monkeypatch.setattr(fabre_methods, "pole_errors", lambda method, rates: method.order / rates)
    fabre_methods.plots(Path())
    lines = curves(drawn["fabre_methods_order.png"][0])
    for method in fabre_methods.STEPPED:
        unstable = " (unstable)" if method.name == "linear_position" else ""
        x, y = lines[f"{method.name}, order {method.order}{unstable}"]
        assert x.tolist() == [50, 100, 200, 400, 800, 1600, 3200, 6400]
        assert (x * y).tolist() == pytest.approx([method.order] * 8)
    monkeypatch.setattr(klosner, "errors", lambda mounting, way: np.array([[9, len(mounting)], [9, len(way)]]))
    problem = replace(klosner.problem_a(), duration=0.1)
    monkeypatch.setattr(klosner, "problems", lambda: [replace(problem, name=name) for name in "ABCD"])
    klosner.plots(Path())
    for axis, mounting in zip(drawn["klosner_modes.png"], klosner.MOUNTINGS, strict=True):
        found = {way: (x.tolist(), y.tolist()) for way, (x, y) in curves(axis).items()}
        assert found == {way: ([1, 2], [len(mounting), len(way)]) for way in klosner.WAYS}
    for left, right in zip(*[iter(drawn["klosner_problems.png"])] * 2, strict=True):
        moves, force = curves(left), curves(right)
        assert moves["S, assembled"][0] == pytest.approx(np.arange(40) / 400)
        for name in ("S", "last mass"):
            truth = moves[f"{name}, assembled"][1]
            assert np.abs(truth).max() > 0.1  # mm
            for form in klosner.FORMS:
                assert moves[f"{name}, {form}"][1] == pytest.approx(truth, abs=0.02 * np.abs(truth).max())
        t, truth = force["assembled"]
        for form in klosner.FORMS:
            x, y = force[form]
            assert y[:-1] == pytest.approx(np.interp(x[:-1], t, truth), abs=0.02 * np.abs(truth).max())


@pytest.fixture
def made_up(monkeypatch):
    """Responses 1 / f of each damping case, and waveforms t^2, in place of those of the systems."""

    def receptance(problem, freq):
        return problem / np.atleast_1d(np.asarray(freq, float))[:, None, None]

    for module in (fabre_guitar, harp):
        monkeypatch.setattr(module, "coupled_receptance", receptance)
        monkeypatch.setattr(module, "problem", lambda basis, case="complex": {"complex": 1, "block": 2}.get(case, 10))
        monkeypatch.setattr(
            module, "pluck", lambda case, fs, seconds: case * (np.arange(round(seconds * fs) + 1) / fs) ** 2
        )


def test_the_guitar_s_pluck_and_spectrum(drawn, made_up) -> None:
    fabre_guitar.plots(Path())
    force, wave, start, spectrum = drawn["fabre_fig5_guitar.png"]
    ((t, newton),) = curves(force).values()
    assert (t[-1], newton.max(), newton[24000]) == (2.0, fabre_guitar.FORCE, fabre_guitar.FORCE / 2)
    assert not newton[t > 1].any()
    assert list(curves(wave)) == ["case 1: complex", "case 2: proportional"]
    for (x, y), case in zip(curves(wave).values(), (1, 10), strict=True):
        assert y == pytest.approx(1e3 * case * x**2)
    for (x, y), case in zip(curves(start).values(), (1, 10), strict=True):
        assert (x[0], x[-1]) == pytest.approx((1.0, 1.1))
        assert y == pytest.approx(1e3 * case * x**2)
    lines = list(curves(spectrum).values())
    for (x, y), case in zip(lines[:2], (1, 10), strict=True):
        assert (x[0], x[-1]) == (pytest.approx(40.0), pytest.approx(1499.9))
        assert y == pytest.approx(20 * np.log10(case / x))
    for n, (x, y) in enumerate(lines[2:18], 1):
        assert float(x[0]) == pytest.approx(fabre_guitar.exact_string().held_freq(n), rel=0.02)
        assert float(y[0]) == pytest.approx(20 * np.log10(1 / x[0]) + 4)
    for (x, y), freq in zip(lines[18:], (89.817, 158.387), strict=True):
        assert float(x[0]) == pytest.approx(freq, abs=6e-4)
        assert float(y[0]) == pytest.approx(20 * np.log10(1 / freq) + 10, abs=1e-3)


def test_the_harp_s_modes_waveform_and_spectrum(drawn, made_up) -> None:
    harp.plots(Path())
    bars, grey, black = drawn["fabre_fig7_harp_modes.png"][:3]
    body = harp.harp_body()
    mpc = harp.phase_collinearity(body.right)
    assert [bar.get_height() for bar in bars.patches] == pytest.approx(mpc)
    assert [bar.get_facecolor() == bars.patches[int(np.argmin(mpc))].get_facecolor() for bar in bars.patches] == (
        mpc < 0.95
    ).tolist()
    criterion = harp.separation(body)
    image = next(a.images[0] for a in (grey, black) if a.images[0].get_array().dtype != bool)
    assert np.asarray(image.get_array()) == pytest.approx(np.minimum(criterion, 1.0))
    frames = [line.get_xdata() for axis in (grey, black) for line in axis.lines]
    assert [x.tolist() if hasattr(x, "tolist") else list(x) for x in frames] == [
        [a, b, b, a, a] for a, b in ((0.5, 10.5), (10.5, 19.5), (19.5, 27.5), (27.5, 32.5))
    ]
    wave, spectrum, difference = drawn["fabre_fig8_harp.png"]
    for (t, y), case in zip(curves(wave).values(), (1, 10), strict=True):
        assert (t[0], t[-1]) == (pytest.approx(-10.0), pytest.approx(60.0, abs=0.1))
        assert y == pytest.approx(np.full(t.size, 2.0 * case), rel=1e-4)
    lines = list(curves(spectrum).values())
    for (f, level), case in zip(lines[:3], (1, 10, 2), strict=True):
        assert (f[0], f[-1]) == (60.0, pytest.approx(1799.9))
        assert level == pytest.approx(20 * np.log10(case / f * (2 * np.pi * f) ** 2))
    odd = body.natural_freq[mpc < 0.95]
    for (x, y), freq in zip(lines[3:], odd, strict=True):
        assert float(x[0]) == freq
        assert float(y[0]) == pytest.approx(20 * np.log10(4 * np.pi**2 * freq) + 6, abs=0.01)
    apart = list(curves(difference).items())
    assert apart[0][1][1] == pytest.approx(np.full(17400, 20 * np.log10(2)))
    assert apart[1][1][1] == pytest.approx(np.full(17400, 20.0))
    assert [float(x[0]) for _, (x, _) in apart[2:]] == pytest.approx(247.0 * np.arange(1, 8), rel=0.02)
