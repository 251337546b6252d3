"""Fault detection and diagnosis for installed HVAC plant."""

__version__ = "0.1.0"
