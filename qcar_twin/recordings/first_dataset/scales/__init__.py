"""Units that no name says, by how the car moved."""
