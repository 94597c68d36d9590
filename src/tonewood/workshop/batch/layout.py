"""Groups of sounds of equal length and level, and the trials of the listeners.

A *group* is a set of sound files that are equally long, have the same channels and are lowered together when one of
them would pass the true-peak limit. A *trial* is judged at one time: a MUSHRA page, or one pair. A condition
that stands in two groups becomes two files with two codes. The repeats of a condition never meet on one rated page.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tonewood.errors import TonewoodError, together
from tonewood.workshop.batch import pages
from tonewood.workshop.batch.conditions import Condition
from tonewood.workshop.batch.manifest import Manifest, ManifestError
from tonewood.workshop.batch.seeds import blind_codes

MAX_SIGNALS = 12  # BS.1534-3: signals on one page, hidden reference and anchors among them
ANCHOR_ROLES = {3500: "anchor35", 7000: "anchor70"}


@dataclass(frozen=True)
class Stimulus:
    """One sound file: its blind code, the condition heard, and whether as it is or as an anchor made of it."""

    code: str
    condition: str
    role: str = "sound"  # sound | anchor35 | anchor70


@dataclass(frozen=True)
class Trial:
    """Sounds that are judged together; `reference` and `stimuli` are codes.

    The two of a pair are the reference and the only stimulus; a sound that is rated alone has no reference.
    """

    id: str
    name: str
    reference: str | None
    stimuli: tuple[str, ...]

    @property
    def codes(self) -> tuple[str, ...]:
        """All codes of the trial, the reference first."""
        return self.stimuli if self.reference is None else (self.reference, *self.stimuli)


@dataclass(frozen=True)
class Group:
    """Files of equal length and level; `page` is the index of the manifest's page they belong to."""

    name: str
    page: int
    fixed: dict[str, str]
    stimuli: tuple[Stimulus, ...]
    trials: tuple[Trial, ...]


def lay_out(manifest: Manifest, conditions: Sequence[Condition]) -> tuple[tuple[Group, ...], list[str]]:
    """All groups of a batch in the manifest's order, and notes on them.

    Raises ManifestError : a page has not exactly one reference, holds more than `MAX_SIGNALS`, or pairs nothing.
    """
    drafts: list[_Draft] = []
    notes: list[str] = []
    faults: list[TonewoodError] = []
    for index, page in enumerate(manifest.pages):
        try:
            if isinstance(page, pages.HtmlPage) and not page.group_by and page.reference is None:
                used = {c for draft in drafts for c in draft.sounds}
                left = [c for c in conditions if c.name not in used]
                drafts += _drafts(manifest, index, page, left, ["instrument", "score", "repeat"], notes)
            elif isinstance(page, pages.SoundPage):
                drafts += _drafts(manifest, index, page, conditions, page.group_by, notes)
        except ManifestError as fault:
            faults.append(fault)
    if faults:
        raise together(faults)
    if not drafts and not any(isinstance(page, pages.StaircasePage) for page in manifest.pages):
        raise ManifestError("no page is left with anything to hear", key="pages")
    names = [name for draft in drafts for name in draft.names()]
    codes = blind_codes(manifest.seed, names)
    return tuple(draft.group(codes) for draft in drafts), notes


@dataclass(frozen=True)
class _Draft:
    """A group before its codes are drawn: sounds by condition name, trials as (reference, others)."""

    name: str
    page: int
    fixed: dict[str, str]
    sounds: tuple[str, ...]
    trials: tuple[tuple[str | None, tuple[str, ...]], ...]
    anchors: tuple[str, ...] = ()
    anchored: str | None = None

    def names(self) -> Iterator[str]:
        yield from (f"{self.name}/{sound}" for sound in (*self.sounds, *self.anchors))
        yield from (f"{self.name}/trial {i}" for i in range(len(self.trials)))

    def group(self, codes: dict[str, str]) -> Group:
        code = {sound: codes[f"{self.name}/{sound}"] for sound in (*self.sounds, *self.anchors)}
        stimuli = [Stimulus(code[sound], sound) for sound in self.sounds]
        stimuli += [Stimulus(code[role], self.anchored or "", role) for role in self.anchors]
        trials = tuple(
            Trial(
                id=codes[f"{self.name}/trial {i}"],
                name=self.name,
                reference=None if reference is None else code[reference],
                stimuli=tuple(sorted(code[sound] for sound in (*others, *self.anchors))),
            )
            for i, (reference, others) in enumerate(self.trials)
        )
        return Group(self.name, self.page, self.fixed, tuple(sorted(stimuli, key=lambda s: s.code)), trials)


def _drafts(
    manifest: Manifest,
    index: int,
    page: pages.SoundPage,
    conditions: Sequence[Condition],
    group_by: list[str],
    notes: list[str],
) -> Iterator[_Draft]:
    rated = isinstance(page, pages.RatedPage)
    keys = [*group_by, "repeat"] if rated and "repeat" not in group_by else group_by
    for fixed, members in _grouped(conditions, keys):
        label = ".".join([f"page{index + 1}", *(f"{k}={v}" for k, v in fixed.items())])
        draft: _Draft | None
        if isinstance(page, pages.PairPage):
            draft = _paired(manifest, index, page, label, fixed, members)
        elif isinstance(page, pages.RatingPage):
            names = tuple(c.name for c in members)
            draft = _Draft(label, index, fixed, names, tuple((None, (name,)) for name in names))
        else:
            draft = _compared(index, page, label, fixed, members)
        if draft is None:
            notes.append(f"{label} is left out: nothing to compare after exclusion")
        else:
            yield draft


def _grouped(conditions: Sequence[Condition], keys: list[str]) -> Iterator[tuple[dict[str, str], list[Condition]]]:
    groups: dict[tuple[str, ...], list[Condition]] = {}
    for condition in conditions:
        groups.setdefault(tuple(condition.all_levels[k] for k in keys), []).append(condition)
    for values, members in groups.items():
        yield dict(zip(keys, values, strict=True)), members


def _compared(
    index: int, page: pages.SoundPage, label: str, fixed: dict[str, str], members: list[Condition]
) -> _Draft | None:
    names = tuple(c.name for c in members)
    reference: dict[str, str] | None = getattr(page, "reference", None)
    cutoffs: list[int] = getattr(page, "anchors", [])
    if reference is None:
        return _Draft(label, index, fixed, names, ((None, names),))
    references = [c.name for c in members if reference.items() <= c.all_levels.items()]
    if len(references) != 1:
        levels = ", ".join(f"{k}: {v}" for k, v in reference.items())
        raise ManifestError(
            f"{{{levels}}} names {len(references)} conditions on {label}, one is wanted"
            + (": name more levels, or more factors in group_by" if references else ""),
            key=f"pages.{index}.reference",
        )
    others = tuple(name for name in names if name != references[0])
    if not others:
        return None
    signals = len(names) + len(cutoffs)
    if isinstance(page, pages.MushraPage) and page.strict and signals > MAX_SIGNALS:
        raise ManifestError(
            f"{signals} signals on {label}; at most {MAX_SIGNALS} (BS.1534), or strict: false", key=f"pages.{index}"
        )
    anchors = tuple(ANCHOR_ROLES[cutoff] for cutoff in cutoffs)
    if isinstance(page, pages.Bs1116Page):  # one sound at a time
        return _Draft(label, index, fixed, names, tuple((references[0], (other,)) for other in others))
    return _Draft(label, index, fixed, names, ((references[0], others),), anchors, references[0])


def _paired(
    manifest: Manifest, index: int, page: pages.PairPage, label: str, fixed: dict[str, str], members: list[Condition]
) -> _Draft | None:
    (factor, pairs), *_ = page.pairs.items()
    trials: list[tuple[str | None, tuple[str, ...]]] = []
    for first, second in pages.as_pairs(pairs, manifest.choices()[factor]):
        partner = {_rest(c, factor): c.name for c in members if c.all_levels[factor] == second}
        for condition in members:
            if condition.all_levels[factor] == first and (other := partner.get(_rest(condition, factor))):
                trials.append((condition.name, (other,)))
    heard = {name for reference, others in trials for name in (reference, *others)}
    if not trials:
        return None
    return _Draft(label, index, fixed, tuple(c.name for c in members if c.name in heard), tuple(trials))


def _rest(condition: Condition, factor: str) -> tuple[tuple[str, str], ...]:
    return tuple((k, v) for k, v in condition.all_levels.items() if k != factor)
