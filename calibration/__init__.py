"""Calibration of the twin on recordings, cross-validation, and diagnosis of missing physics."""
