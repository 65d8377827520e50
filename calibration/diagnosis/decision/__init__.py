"""What is said of a car, from plain numbers alone: evidence in, names and a verdict out."""
