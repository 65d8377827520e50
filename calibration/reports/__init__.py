"""The pages of calibration, cross-validation and checked logs: what `qcar_twin.pages` is given of each."""
