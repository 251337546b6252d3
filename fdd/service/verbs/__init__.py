"""One file a command of ``fdd``."""
