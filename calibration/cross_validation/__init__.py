"""Models against recordings that took no part in their fits."""

from calibration.cross_validation.cross_validation import CrossValidation, cross_validate, find_reference
from calibration.cross_validation.model_difference import ModelDifference, compare_by_region

__all__ = ["CrossValidation", "ModelDifference", "compare_by_region", "cross_validate", "find_reference"]
