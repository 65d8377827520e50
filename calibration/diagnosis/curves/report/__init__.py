"""What free curves found, on pages and in sentences: curves in physical units, cars and sessions compared."""
