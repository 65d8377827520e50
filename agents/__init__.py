"""Path-tracking controllers and the learning agent."""
