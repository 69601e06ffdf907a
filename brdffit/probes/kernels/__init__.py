"""Compiled loops of the probes: geometry, trees, tables; they know arrays only."""
