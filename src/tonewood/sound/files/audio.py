"""Sound in memory, and sound files as `AtomicFile`s."""

from __future__ import annotations

import html
import io
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from tonewood.errors import OutputError
from tonewood.performance.score.note import Dropped
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.sound.files.tags import NO_TAGS, Tags
from tonewood.sound.level.spectrum import level_curve, spectrogram
from tonewood.support.arrays import Floats
from tonewood.support.plotting import COLOURS, LINE, colour_bar, data_uri, draw_spectrogram, figure
from tonewood.support.whole_files import AtomicFile

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: bytes a plain WAV file can hold; larger files become RF64
_WAV_LIMIT = 4_000_000_000
_BYTES = {"PCM_16": 2, "PCM_24": 3, "PCM_32": 4, "FLOAT": 4, "DOUBLE": 8}
_SUBTYPES = {
    "WAV": tuple(_BYTES), "RF64": tuple(_BYTES), "FLAC": ("PCM_16", "PCM_24"), "OGG": ("VORBIS",),
    "MP3": ("MPEG_LAYER_III",),
}  # fmt: skip
_FORMATS = {".wav": "WAV", ".rf64": "RF64", ".flac": "FLAC", ".ogg": "OGG", ".mp3": "MP3"}
#: formats that lose some of the sound, which not every libsndfile writes
_LOSSY = ("OGG", "MP3")
#: most channels that a format holds
_CHANNELS = {"FLAC": 8, "OGG": 255, "MP3": 2, "WAV": 1024, "RF64": 1024}
_MP3_RATES = (8000, 11025, 12000, 16000, 22050, 24000, 32000, 44100, 48000)
#: Hz, above which libvorbis has no modes, and libsndfile 1.2 ends the process
_OGG_RATE = 200_000
#: frames that are handed to libsndfile at a time: its Vorbis encoder keeps a block on the stack
_AT_ONCE = 65536


@dataclass(frozen=True, eq=False)
class Audio:
    """Sound in memory.

    Attributes
    ----------
    samples : (n, n_channels), 1.0 is full scale.
    fs : sampling rate, Hz.
    channels : their names.
    energy : account of energy of the render, if it was asked for.
    dropped : notes of the score that could not be played, and why.
    tags : texts for its file.
    """

    samples: Floats
    fs: int
    channels: tuple[str, ...] = ()
    energy: EnergyTrace | None = None
    dropped: tuple[Dropped, ...] = ()
    tags: Tags = NO_TAGS

    def __repr__(self) -> str:
        shape = f"{len(self.samples)} samples x {self.samples.shape[1]}"
        return f"Audio({shape}, {self.duration:.6g} s at {self.fs} Hz, peak {self.peak_dbfs:.1f} dBFS)"

    def _repr_html_(self) -> str:
        """Player of the first two channels; a sound beyond full scale is lowered to it, and the text says so."""
        peak = float(np.max(np.abs(self.samples), initial=0.0))
        gain = min(1.0, 1.0 / peak) if peak > 0 else 1.0
        channels = ", ".join(self.channels[:2]) or f"{self.samples.shape[1]} channels"
        text = f"{channels}, {self.duration:.2f} s at {self.fs} Hz, peak {self.peak_dbfs:.1f} dBFS"
        if gain < 1.0:
            text += f", played {-self.peak_dbfs:+.1f} dB"
        address = data_uri(flac_bytes(gain * self.samples[:, :2], self.fs), "audio/flac")
        return f'<p>{html.escape(text)}</p><audio controls src="{address}"></audio>'

    def spectrogram(self, *, freq_upper: float = 8000.0, range_db: float = 80.0, window: int = 4096) -> Figure:
        """Draw the level over time and frequency of the mean of all channels, dB re its maximum.

        Parameters
        ----------
        freq_upper : Hz, highest frequency shown.
        range_db : dB shown below the maximum.
        window : samples of the Hann window; its main lobe is 4 fs / window wide.
        """
        shown = min(freq_upper, self.fs / 2)
        time, freq, level = spectrogram(self.samples, self.fs, window=window, columns=1000, freq_upper=shown)
        chart, axes = figure(heights=[4.5])
        image = draw_spectrogram(axes[0, 0], time, freq, level - level.max(), floor_db=-range_db)
        axes[0, 0].set_xlabel("time, s")
        colour_bar(chart, image, axes[0, 0], "level\ndB re maximum")
        return chart

    def plot_decay(self, *, range_db: float = 80.0) -> Figure:
        """Draw the level over time, 10 lg of the mean square over 20 ms and all channels, dB re full scale.

        Parameters
        ----------
        range_db : dB shown below the maximum.
        """
        time, level = level_curve(self.samples, self.fs)
        chart, axes = figure(heights=[4.0])
        axes[0, 0].plot(time, level, color=COLOURS[0], lw=LINE)
        top = float(level.max())
        axes[0, 0].set(xlabel="time, s", ylabel="level\ndB re full scale", ylim=(top - range_db, top + 5.0))
        return chart

    @property
    def duration(self) -> float:
        """Length in s."""
        return len(self.samples) / self.fs

    @property
    def peak_dbfs(self) -> float:
        """Largest sample, dB re full scale; -inf for silence."""
        return decibels(float(np.max(np.abs(self.samples), initial=0.0)))

    def save(self, path: str | os.PathLike[str], subtype: str | None = None) -> int:
        """Write a sound file; returns how many samples lay beyond full scale, and warns if there were any.

        Parameters
        ----------
        path : whose suffix names the format: ``.wav``, ``.flac``, ``.rf64``, ``.ogg`` or ``.mp3``.
        subtype : of the samples, e.g. ``PCM_24``; by default that of the format.

        Raises
        ------
        OutputError : unknown suffix or subtype, or the file cannot be written.
        """
        n_channels = self.samples.shape[1]
        with SoundWriter(path, self.fs, n_channels, subtype, frames=len(self.samples), tags=self.tags) as writer:
            writer.write(self.samples)
        if writer.clipped:
            fate = "lie beyond full scale" if writer.keeps_peaks else "were clipped"
            peak = f"the peak is {self.peak_dbfs:+.1f} dBFS"
            warnings.warn(f"{os.fspath(path)}: {writer.clipped} samples {fate}, {peak}", stacklevel=2)
        return writer.clipped


def flac_bytes(samples: Floats, fs: int) -> bytes:
    """(n, n_channels) samples as a FLAC file of 16 bits, which browsers play; cut at full scale."""
    import soundfile as sf

    stream = io.BytesIO()
    sf.write(stream, np.clip(samples, -1.0, 1.0), fs, format="FLAC", subtype="PCM_16")
    return stream.getvalue()


def decibels(amplitude: float) -> float:
    """20 lg of an amplitude, -inf for 0."""
    return float(20 * np.log10(amplitude)) if amplitude > 0 else -np.inf


def file_format(path: str | os.PathLike[str], subtype: str | None, n_bytes_needed: float = 0.0) -> tuple[str, str]:
    """Container and subtype for a path: by its suffix, and RF64 where WAV would overflow.

    Raises OutputError : names the suffixes or subtypes allowed; or the libsndfile that is installed does not write it.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _FORMATS:
        raise OutputError(f"suffix {suffix!r} is none of {', '.join(_FORMATS)}", file=path)
    container = _FORMATS[suffix]
    chosen = (subtype or ("PCM_24" if "PCM_24" in _SUBTYPES[container] else _SUBTYPES[container][0])).upper()
    if chosen not in _SUBTYPES[container]:
        raise OutputError(f"{container} has no subtype {chosen}; allowed: {', '.join(_SUBTYPES[container])}", file=path)
    if container in _LOSSY:
        import soundfile as sf

        if chosen not in sf.available_subtypes(container):
            others = ", ".join(name for name, kind in _FORMATS.items() if kind not in _LOSSY)
            version = sf.__libsndfile_version__
            raise OutputError(f"libsndfile {version} does not write {suffix}; {others} are written", file=path)
    if container == "WAV" and n_bytes_needed * _BYTES[chosen] > _WAV_LIMIT:
        container = "RF64"
    return container, chosen


def check_rate_and_channels(path: str | os.PathLike[str], fs: int, n_channels: int = 1) -> None:
    """Refuse a sampling rate (Hz) or a number of channels that the format of a path does not hold.

    Raises OutputError : names the value and what is allowed.
    """
    if reason := not_held(file_format(path, None)[0], fs, n_channels):
        raise OutputError(reason, file=path)


def not_held(container: str, fs: int, n_channels: int = 1) -> str | None:
    """Reason why a container does not hold a sampling rate (Hz) or a number of channels; None where it does."""
    rates = {
        "FLAC": (
            fs <= 65535 or (fs <= 655_350 and fs % 10 == 0),
            "up to 65535 Hz, and multiples of 10 Hz up to 655350 Hz",
        ),
        "OGG": (fs <= _OGG_RATE, f"up to {_OGG_RATE} Hz"),
        "MP3": (fs in _MP3_RATES, ", ".join(map(str, _MP3_RATES)) + " Hz"),
    }
    held, allowed = rates.get(container, (True, ""))
    if not held:
        return f"the sampling rate is {fs} Hz; {container} holds {allowed}"
    if n_channels > _CHANNELS[container]:
        return f"has {n_channels} channels; {container} holds up to {_CHANNELS[container]}"
    return None


class SoundWriter:
    """Streams blocks into a sound file that appears under its name only when it is complete.

    Used with ``with``; leaving it by an error (or Ctrl-C) removes the file begun.

    path : final name; the suffix decides the format. Or a file to write in place, which is left as it is.
    fs, n_channels : Hz, number of channels.
    subtype : PCM_16, PCM_24 (default), PCM_32, FLOAT or DOUBLE; ``.ogg`` is VORBIS, ``.mp3`` MPEG_LAYER_III.
    frames : how many are expected at most, to choose RF64 in time.
    tags : texts that it carries.
    clipped : samples beyond full scale so far (integer formats cut them; floating ones keep them).
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | AtomicFile,
        fs: int,
        n_channels: int,
        subtype: str | None = None,
        *,
        frames: int = 0,
        tags: Tags = NO_TAGS,
    ):
        import soundfile as sf

        self._own = not isinstance(path, AtomicFile)
        self.path = path.path if isinstance(path, AtomicFile) else Path(path)
        container, self.subtype = file_format(self.path, subtype, float(frames) * n_channels)
        check_rate_and_channels(self.path, fs, n_channels)
        self.clipped, self.frames, self.peak = 0, 0, 0.0
        self._new = path if isinstance(path, AtomicFile) else AtomicFile(path)
        try:
            self._file = sf.SoundFile(str(self._new.path), "w", fs, n_channels, subtype=self.subtype, format=container)
            tags.enter(self._file)
        except (sf.LibsndfileError, OSError) as error:
            reason = _reason(self._new.path, error)
            if self._own:
                self._new.discard()
            raise OutputError(f"cannot be written: {reason}", file=self.path) from None

    @property
    def keeps_peaks(self) -> bool:
        """Whether the file holds numbers beyond full scale as they are; integers are cut there."""
        return self.subtype.startswith(("FLOAT", "DOUBLE"))

    def __enter__(self) -> SoundWriter:
        return self

    def write(self, block: Floats) -> None:
        """Append (n, n_channels) samples. Raises OutputError : the disk is full, or a sample is not a number."""
        import soundfile as sf

        if not np.all(np.isfinite(block)):
            raise OutputError("a sample is not a finite number; nothing was written", file=self.path)
        over = np.abs(block) > 1.0
        self.clipped += int(np.count_nonzero(over))
        self.peak = max(self.peak, float(np.max(np.abs(block), initial=0.0)))
        if not self.keeps_peaks:
            block = np.clip(block, -1.0, 1.0)
        try:
            for first in range(0, len(block), _AT_ONCE):
                self._file.write(block[first : first + _AT_ONCE])
        except (sf.LibsndfileError, OSError) as error:
            raise OutputError(f"cannot be written: {_reason(self._new.path, error)}", file=self.path) from None
        self.frames += len(block)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import soundfile as sf

        try:
            self._file.close()
            # libsndfile does not report a disk that is full when it writes its last buffer
            complete = kind is None and sf.info(str(self._new.path)).frames == self.frames
            if kind is None and not complete:
                raise OutputError("is incomplete on disk (is it full?)", file=self.path)
            if complete and self._own:
                self._new.complete()
        except (sf.LibsndfileError, OSError) as fault:
            raise OutputError(f"cannot be written: {_reason(self._new.path, fault)}", file=self.path) from None
        finally:
            if self._own:
                self._new.discard()


def _reason(path: Path, error: Exception) -> str:
    """Reason why a file cannot be written: libsndfile reports system errors without their message."""
    try:
        with path.open("ab") as stream:
            stream.write(bytes(1 << 20))
    except OSError as fault:
        return fault.strerror or str(fault)
    return str(error)
