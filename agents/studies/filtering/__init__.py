"""What the filter gets through, and what it makes of a car that is not its model."""
