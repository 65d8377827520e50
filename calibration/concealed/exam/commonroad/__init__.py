"""The multi-body car of `commonroad-vehicle-models` (Althoff and Wuersching, BSD), at 1:10 and at full size."""
