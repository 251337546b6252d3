"""Alarms: their life by ISA-18.2, and what was kept of the promise."""
