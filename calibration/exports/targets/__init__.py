"""One file per target of an export."""
