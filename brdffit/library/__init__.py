"""Libraries of materials: many texture sets in one run, resumed where it stopped, on one machine or on many.

``run.run_library`` is the way in; what one set needs stands in ``task`` and ``bake``, the workers in ``pool``
(processes of this machine) and ``cluster`` (Dask).
"""
