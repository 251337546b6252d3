"""Reports for service technicians, in HTML and PDF."""
