"""The error of a command that cannot be done as asked."""

from __future__ import annotations


class UsageError(ValueError):
    """Something in the command or the site that cannot be done; the text says what to do instead."""
