"""Playing live: MIDI messages, keyboards, sound cards and takes around `tonewood.sound.live.instrument.Live`."""
