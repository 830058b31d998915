"""Samplers behind `calibration.sample`."""
