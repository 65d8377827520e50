"""The twin written down for other tools, each with what was lost in translation."""
