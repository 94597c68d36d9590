"""What to change so that a body reaches its targets: targets, free parameters, derivatives, the nearest design."""
