"""Equipment that is watched by physical expectations from its first day; one file a kind."""
