"""Texts of a sample library: SFZ, and the preset of Decent Sampler.

Loudness. A sample serves the velocities of its layer, whose levels lie on the straight lines (in dB) between the
measured levels of the layers. Its region takes the level at the layer's highest velocity as `volume`, and the ratio of
the others to it as `amp_velcurve`: the library is as loud at every velocity as the instrument is at those rendered.

Releases. The sound of a key that comes up was rendered after `KEY_DOWN` s. `rt_decay` lowers it by the note's own decay
in dB per second since its beginning; `volume` adds that of the first `KEY_DOWN` s.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from tonewood.workshop.sampling.notes import Span
from tonewood.workshop.sampling.strokes import KEY_DOWN

#: s, in which a sample fades when its key comes up and its release takes over
_HANDOVER = 0.03
#: velocities at which the loudness of a region is written
_POINTS = (1, 16, 32, 48, 64, 80, 96, 112, 127)


@dataclass(frozen=True)
class Region:
    """One sound file and the notes that it serves.

    keys, velocities : served.
    repeat, n_repeats : of the round robins.
    levels : velocity -> measured level of this key, dB.
    decay_db : of a release, dB per s of the note's decay; None for a note.
    """

    file: str
    keys: Span
    velocities: Span
    repeat: int
    n_repeats: int
    levels: Mapping[int, float]
    decay_db: float | None = None

    def level(self, velocity: float) -> float:
        """Return the level of the key at a velocity, dB: on straight lines between those measured, and beyond them."""
        velocities = sorted(self.levels)
        if len(velocities) == 1:
            return self.levels[velocities[0]] + 40.0 * float(np.log10(max(velocity, 1.0) / velocities[0]))
        i = int(np.clip(np.searchsorted(velocities, velocity), 1, len(velocities) - 1))
        low, high = velocities[i - 1], velocities[i]
        slope = (self.levels[high] - self.levels[low]) / (high - low)
        return self.levels[low] + slope * (velocity - low)

    @property
    def volume_db(self) -> float:
        """Gain of the sample at its highest velocity, dB."""
        volume = self.level(self.velocities.high) - self.level(self.velocities.centre)
        return volume + (0.0 if self.decay_db is None else self.decay_db * KEY_DOWN)

    @property
    def curve(self) -> dict[int, float]:
        """Velocity -> gain re that at the highest velocity, at most 1."""
        low, high = self.velocities.low, self.velocities.high
        points = sorted({low, high, *(v for v in _POINTS if low < v < high)})
        return {v: min(1.0, 10 ** ((self.level(v) - self.level(high)) / 20)) for v in points}


def sfz_text(regions: Sequence[Region], folder: str, about: Sequence[str], *, rings: bool) -> str:
    """Return the text of an SFZ file.

    folder : of the samples, beside the file.
    about : lines of a comment at its head.
    rings : whether notes go on when their keys come up.
    """
    lines = [*(f"// {line}" for line in about), f"<control> default_path={folder}/", "<global> amp_veltrack=100"]
    end = "loop_mode=one_shot" if rings else f"loop_mode=no_loop ampeg_release={_HANDOVER:g}"
    for release in (False, True):
        chosen = [r for r in regions if (r.decay_db is not None) == release]
        if chosen:
            lines.append("<group> trigger=release loop_mode=one_shot" if release else f"<group> {end}")
        lines += [_region(r) for r in chosen]
    return "\n".join(lines) + "\n"


def _region(region: Region) -> str:
    keys, velocities = region.keys, region.velocities
    words = [
        f"<region> sample={region.file}",
        f"pitch_keycenter={keys.centre} lokey={keys.low} hikey={keys.high}",
        f"lovel={velocities.low} hivel={velocities.high} volume={region.volume_db:.2f}",
    ]
    words += [f"amp_velcurve_{v}={gain:.4f}" for v, gain in region.curve.items()]
    if region.n_repeats > 1:
        words.append(f"seq_length={region.n_repeats} seq_position={region.repeat}")
    if region.decay_db is not None:
        words.append(f"rt_decay={region.decay_db:.2f}")
    return " ".join(words)


def decent_text(regions: Sequence[Region], folder: str, about: Sequence[str], *, rings: bool) -> str:
    """Return a preset of Decent Sampler, arguments as for `sfz_text`."""
    root = ElementTree.Element("DecentSampler", minVersion="1.0.0")
    root.append(ElementTree.Comment(" " + re.sub("--+", "-", " | ".join(about)) + " "))
    groups = ElementTree.SubElement(root, "groups")
    for release in (False, True):
        chosen = [r for r in regions if (r.decay_db is not None) == release]
        if not chosen:
            continue
        ended = "5" if release or rings else f"{_HANDOVER:g}"
        group = ElementTree.SubElement(
            groups, "group", trigger="release" if release else "attack", seqMode="round_robin", ampVelTrack="1",
            attack="0", decay="0", sustain="1", release=ended,
        )  # fmt: skip
        for r in chosen:
            ElementTree.SubElement(
                group, "sample", path=f"{folder}/{r.file}", rootNote=str(r.keys.centre), loNote=str(r.keys.low),
                hiNote=str(r.keys.high), loVel=str(r.velocities.low), hiVel=str(r.velocities.high),
                volume=f"{r.volume_db:.2f}dB", seqLength=str(r.n_repeats), seqPosition=str(r.repeat),
            )  # fmt: skip
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
