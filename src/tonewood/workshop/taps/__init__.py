"""Taps: what rings after a knock, from a microphone or a sensor, without the force."""
