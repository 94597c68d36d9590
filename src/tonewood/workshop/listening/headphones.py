"""Sounds of the check of headphones: Huggins pitch, and tones in antiphase.

Both have three intervals of 1 s in two channels. *Huggins pitch* (A. E. Milne, R. Bianco, K. C. Poole, S. Zhao,
A. J. Oxenham, A. J. Billig & M. Chait, Behav. Res. Methods 53 (2021) 1551): white noise, the same in both channels; in
the interval to be found the right one has a constant phase shift of 180 degrees from 564 to 636 Hz (600 Hz +- 6 %),
which is heard as a faint tone at 600 Hz where each ear gets its own channel. *Antiphase* (K. J. P. Woods, M. H. Siegel,
J. Traer & J. H. McDermott, Atten. Percept. Psychophys. 79 (2017) 2064): three tones of 200 Hz; the one to be found is
6 dB softer, one of the others is in antiphase between the channels, and in a room softer than that.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from tonewood.workshop.batch.pages import HeadphonesPage
from tonewood.workshop.batch.production import encoded_wav
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.batch.stimuli import quantised
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.trials import CHANGED, INTERVALS

SECONDS = 1.0
#: Hz, band of the Huggins pitch
BAND = (564.0, 636.0)
#: Hz and dB, of the tones in antiphase
TONE, SOFTER = 200.0, -6.0
#: s, of the onset and offset ramps
RAMPS = {"huggins": 0.02, "antiphase": 0.1}
#: RMS of a channel re that of the stimuli's loudness: LUFS of two equal channels is 3.01 dB more than of one
_STEREO_DB = -3.01


def huggins(fs: int, pitch: bool, random: np.random.Generator) -> NDArray[np.float64]:
    """White noise of 1 s and RMS 1, shape (fs, 2); with `pitch` the band around 600 Hz is in antiphase."""
    noise = random.standard_normal(round(SECONDS * fs))
    noise /= np.sqrt(np.mean(noise**2))
    spectrum = np.fft.rfft(noise)
    freqs = np.fft.rfftfreq(len(noise), 1 / fs)
    band = (freqs >= BAND[0]) & (freqs <= BAND[1])
    shifted = np.fft.irfft(np.where(band, -spectrum, spectrum), len(noise))
    return np.stack([noise, shifted if pitch else noise], axis=1)


def tone(fs: int, softer: bool, opposite: bool) -> NDArray[np.float64]:
    """A tone of 200 Hz, 1 s and RMS 1, shape (fs, 2); 6 dB softer, or with the right channel's sign changed."""
    t = np.arange(round(SECONDS * fs)) / fs
    sound = np.sqrt(2.0) * np.sin(2 * np.pi * TONE * t) * 10.0 ** ((SOFTER if softer else 0.0) / 20.0)
    return np.stack([sound, -sound if opposite else sound], axis=1)


def ramped(sound: NDArray[np.float64], fs: int, seconds: float) -> NDArray[np.float64]:
    """The sound with raised-cosine ramps at both ends."""
    n = round(seconds * fs)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / n)
    window = np.ones(len(sound))
    window[:n], window[-n:] = ramp, ramp[::-1]
    return np.asarray(sound * window[:, None], dtype=np.float64)


def interval(test: ListeningTest, page: HeadphonesPage, session: Session, slot: str) -> bytes:
    """One interval of the session's step as WAV in two channels, as strong as the stimuli (RMS for LUFS)."""
    step, fs, seed = session.step, test.manifest.stimuli.fs, test.manifest.seed
    assert step is not None
    labels = (session.seed, step.index)
    changed = step.slots[slot] == CHANGED
    if page.method == "huggins":
        sound = huggins(fs, changed, generator(seed, "headphones noise", *labels, slot))
    else:
        others = [name for name in INTERVALS if step.slots[name] != CHANGED]
        opposite = others[int(generator(seed, "headphones antiphase", *labels).integers(len(others)))]
        sound = tone(fs, changed, slot == opposite)
    level = 10.0 ** ((test.manifest.stimuli.loudness.target_lufs + _STEREO_DB) / 20.0)
    sound = ramped(sound, fs, RAMPS[page.method]) * level
    sound /= max(1.0, float(np.max(np.abs(sound))) / 0.99)
    stream = io.BytesIO()
    samples = quantised(sound, "PCM_24", generator(seed, "headphones dither", *labels, slot))
    encoded_wav(stream, samples, fs, "PCM_24")
    return stream.getvalue()
