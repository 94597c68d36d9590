"""From notes to samples: scores, how they are played, effects that are switched, the engine."""
