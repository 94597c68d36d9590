"""Tags of sound files: what is played, on which instrument, and by which version; no dates, so that files repeat."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tonewood.support.text_files import one_line

if TYPE_CHECKING:
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.performance.score.note import Score

#: characters of a text
_LONGEST = 400


@dataclass(frozen=True)
class Tags:
    """Texts that a sound file carries; an empty one is left out.

    title, composer : of the music.
    instrument : what it is played on.
    licence : of the instruments' data.
    """

    title: str = ""
    composer: str = ""
    instrument: str = ""
    licence: str = ""

    @classmethod
    def of(cls, score: Score | None, instruments: Iterable[Instrument]) -> Tags:
        """Tags of a score, if there is one, and the instruments that play it."""
        specs = [instrument.spec for instrument in instruments]
        texts = {} if score is None else score.metadata
        return cls(
            texts.get("title", ""),
            texts.get("composer", ""),
            ", ".join(dict.fromkeys(spec.title or spec.name for spec in specs)),
            ", ".join(dict.fromkeys(spec.licence for spec in specs if spec.licence)),
        )

    def enter(self, file: Any) -> None:
        """Write them into an open `soundfile.SoundFile` of which no sample is written yet.

        libsndfile has no composer, instrument or licence in all formats: these are artist, comment and copyright.
        """
        from tonewood import __version__

        texts = {
            "title": self.title, "artist": self.composer, "comment": self.instrument, "copyright": self.licence,
            "software": f"tonewood {__version__}",
        }  # fmt: skip
        if file.format in ("FLAC", "OGG"):
            texts["license"] = self.licence
        for name, text in texts.items():
            if file.format == "MP3":  # libsndfile's encoder takes every byte for a letter of Latin-1
                text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
            if plain := one_line(text)[:_LONGEST]:
                setattr(file, name, plain)


#: of a file of which nothing but the program is known
NO_TAGS = Tags()
