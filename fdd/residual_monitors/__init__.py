"""Control charts on innovations, scores and estimates, with limits from a false-alarm budget."""
