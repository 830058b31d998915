"""Differentiable process models for machining, in JAX.

The physics only: no fitting and no printing. Each process is one subpackage
(`procmodel.wear` is the first); `procmodel.io` reads and writes files at the edge.
"""

__version__ = "0.1.0"
