"""The twin with curves of no known form in its maps: what it reaches, and which named forms the curves have."""
