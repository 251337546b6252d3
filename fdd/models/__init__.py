"""Component equations: one file a component; nothing but physics and its sources."""
