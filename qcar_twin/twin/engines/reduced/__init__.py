"""The reduced car: the twin's structure written out in C, for searching. See docs/reference/reduced.md."""
