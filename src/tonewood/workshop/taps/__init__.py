"""Tap tones: modes that ring after a knock, from a microphone or a sensor, without the force."""
