"""Sample libraries: an instrument's notes as sound files, and the text that tells a sampler when to play which."""
