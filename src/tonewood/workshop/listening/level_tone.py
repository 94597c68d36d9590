"""The tone by which listeners set the playback level."""

from __future__ import annotations

import io

import numpy as np

from tonewood.sound.level.loudness import sine_loudness
from tonewood.workshop.batch.pages import LevelPage
from tonewood.workshop.batch.production import encoded_wav
from tonewood.workshop.batch.stimuli import quantised
from tonewood.workshop.listening.definition import ListeningTest


def tone(test: ListeningTest, page: LevelPage) -> bytes:
    """Two seconds of a sine as loud as the stimuli, as WAV; it can be looped without a click.

    A sine of amplitude a has the loudness 20 log10(a) more than `sine_loudness`: -3.01 + 20 log10(a) LUFS at 1 kHz in
    one channel, 3.01 more in two, 3.3 more at 4 kHz.

    Raises StimulusError : it would pass full scale.
    """
    settings = test.manifest.stimuli
    level = settings.loudness.target_lufs - sine_loudness(page.freq, settings.channels)
    cycles = round(2.0 * page.freq)  # whole periods: the end meets the beginning
    t = np.arange(2 * settings.fs) / settings.fs
    sound = 10.0 ** (level / 20.0) * np.sin(2 * np.pi * cycles / 2.0 * t)
    samples = quantised(np.repeat(sound[:, None], settings.channels, axis=1), "PCM_24", np.random.default_rng(0))
    stream = io.BytesIO()
    encoded_wav(stream, samples, settings.fs, "PCM_24")
    return stream.getvalue()
