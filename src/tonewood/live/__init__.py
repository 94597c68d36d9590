"""Playing live: MIDI messages, keyboards, sound cards and takes around `tonewood.output.live.Live`."""
