"""Experiments: one folder per paper, each run as ``python -m experiments.<paper>``.

Every folder states a claim of its paper, recomputes it with the library, and compares the key
numbers with ``expected.json``. The wheel does not ship this package.
"""
