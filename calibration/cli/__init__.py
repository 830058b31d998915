"""The command `procmodel`. Importing this package loads no JAX; the commands do, when they run."""

from calibration.cli.app import main

__all__ = ["main"]
