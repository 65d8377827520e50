"""The twin beside the car: what was measured, what it predicts, and evidence at any time that it no longer holds."""
