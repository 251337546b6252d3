"""The engine: one step from samples to verdicts."""
