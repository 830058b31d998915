"""Timings and results of procmodel beside what its users would write themselves.

`python -m benchmarks` runs everything and writes benchmarks/RESULTS.md.
"""
