"""Partials, pitches and wolf notes of an assembled instrument."""
