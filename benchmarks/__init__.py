"""Benchmarks: speed, memory, start-up, the integral, accuracy against an oracle. ``python -m benchmarks --quick``.

Each concern has a file, which returns a ``Section`` of records. Rows that lose stay in.
"""
