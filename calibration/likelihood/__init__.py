"""The likelihood of recordings under a twin with process noise, and a diagnosis that rests on it."""
