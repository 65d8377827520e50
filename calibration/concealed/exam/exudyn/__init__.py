"""A rigid-body car with wheels in contact with the floor, made of Exudyn's joints and rolling discs, as a generator."""
