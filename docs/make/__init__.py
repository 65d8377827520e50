"""What writes the generated pages and pictures; `make docs` runs it."""
