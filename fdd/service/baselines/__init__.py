"""Baselines: identified, judged by gates, kept by version, identified anew."""
