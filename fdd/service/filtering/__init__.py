"""From samples to innovations: frames, filters, and what is remembered of the last days."""
