"""What a model leaves over: structure without a name, and rivals without a name that explain it."""
