"""From charts that alarm to causes a technician can check."""
