"""A formula for what has no name: the force a model misses, what it is a function of, and the twin with it."""
