"""Each page of docs/extending.md done in a temporary copy of the project."""
