"""Parts of strings that a choice of effects leaves out, and places that a bundle does not name."""

from __future__ import annotations

import pytest

import tonewood as tw
from tonewood.instrument.model.assembly import assemble


def test_motion_along_a_string_is_there_where_its_effect_is() -> None:
    struck = tw.load_instrument("struck_monochord")
    (name,) = assemble(struck, 24000.0).strings
    for mode, there in (("all", True), ("none", False)):
        made = assemble(struck.replace({"effects.mode": mode}), 24000.0)
        assert (made.strings[name].longitudinal is not None) == there
        assert (f"{name}.longitudinal" in made.system.names) == there


@pytest.mark.parametrize("stop", [0, 7, 12, 19])
def test_a_pluck_without_a_place_stays_on_the_string(stop: int) -> None:
    """The bundle's place, or nine tenths of what is left of the string: its mode shapes are those of that place."""
    model = assemble(tw.load_instrument("classical_guitar").replace({"exciters.pluck.from_bridge": 0.3}), 24000.0)
    string = model.strings["E2"]
    place = min(0.3, 0.9 * string.length(stop))
    usual, asked = string.bases(stop), string.bases(stop, pluck_from_bridge=place)
    for component, basis in usual.items():
        if "pluck" in basis.points:
            there = asked[component]
            assert basis.right[basis.index("pluck")] == pytest.approx(there.right[there.index("pluck")])
