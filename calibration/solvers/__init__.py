"""Solvers behind one call: our bounded Levenberg-Marquardt and the adapters."""
