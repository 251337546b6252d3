"""``python -m fdd`` is the command ``fdd``."""

from fdd.cli import main

main()
