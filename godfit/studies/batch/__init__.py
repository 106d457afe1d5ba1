"""Many fits, on one machine or several, that may be killed at any moment.

``jobs`` lists what is to be fitted, ``engine`` has it fitted by workers (``worker``), ``journal``
keeps the results, and ``table`` and ``report`` turn them into files. ``run`` goes through all of
them. Nothing here imports JAX before a fit: a worker chooses its core first.
"""
