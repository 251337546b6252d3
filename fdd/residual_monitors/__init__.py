"""Control charts, one a file, and the run-length solver that sets their limits."""
