"""Which of the effects that an instrument's plugins declare may run, and the budgets for leaving one out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.schema import Effects
from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.effects import Effect
from tonewood.support.validation_messages import did_you_mean


@dataclass(frozen=True, slots=True)
class Choice:
    """Effects that may run, and the budgets of those that are switched.

    mode : ``auto``, ``all``, ``none``, or ``list`` for those named.
    names : effects that may run at all.
    budget_db, budget_cents : largest error by which one may be left out.
    """

    mode: str
    names: frozenset[str]
    budget_db: float
    budget_cents: float

    @classmethod
    def of(cls, request: Effects, declared: Mapping[str, Effect]) -> Choice:
        """Resolve a bundle's ``effects`` for the effects that its parts declare.

        Raises TonewoodError : a name is none of theirs.
        """
        basic = {name for name, effect in declared.items() if effect.basic}
        if isinstance(request.mode, str):
            names = set(declared) if request.mode in ("auto", "all") else basic
            return cls(request.mode, frozenset(names), request.budget_db, request.budget_cents)
        unknown = [name for name in request.mode if name not in declared]
        if unknown:
            allowed = ", ".join(sorted(declared)) or "none"
            hint = did_you_mean(unknown[0], declared)
            raise TonewoodError(f"there is no effect {unknown[0]!r}; {hint}auto, all, none or {allowed}", key="effects")
        return cls("list", frozenset(basic | set(request.mode)), request.budget_db, request.budget_cents)

    def keeps(self, plugin: Plugin[Any], name: str | None = None) -> bool:
        """Whether a part runs its effect `name`, or any of its effects; an effect that is not declared always runs."""
        declared_effects = [effect.name for effect in plugin.effects if name is None or effect.name == name]
        return not declared_effects or any(effect in self.names for effect in declared_effects)


def declared(plugins: Iterable[Plugin[Any]]) -> dict[str, Effect]:
    """Effects that the parts of an instrument declare: name -> effect."""
    return {effect.name: effect for plugin in plugins for effect in plugin.effects}
