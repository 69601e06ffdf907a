"""Where a fit of lobes usually breaks: a catalogue of cases, the laws that hold over all of them, and a search."""
