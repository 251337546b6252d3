"""The engine, the alarms, the checkpoints and the daemon around them."""
