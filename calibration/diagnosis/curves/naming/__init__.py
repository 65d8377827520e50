"""Which effects of the catalogue a car has: in the place of a curve, beside the curves, or in place of one another."""
