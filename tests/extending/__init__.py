"""Each page of docs/guide/extending.md done in a temporary copy of the project."""
