"""Many logs of many cars: each checked, calibrated or diagnosed, and their history by car and day."""
