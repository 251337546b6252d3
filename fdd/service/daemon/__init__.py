"""The daemon: the engine as a process, its checkpoint, doors and jobs."""
