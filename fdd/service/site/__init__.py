"""The site opened: its file, what follows from it, and the samples that its sources give."""
