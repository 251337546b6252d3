"""From an export to a draft of a site file."""
