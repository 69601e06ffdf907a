"""Benchmarks: speed, memory, start-up, the integral, accuracy against an oracle. ``python -m benchmarks --quick``.

One file a concern; each returns a ``Section`` of records. Losing rows stay in.
"""
