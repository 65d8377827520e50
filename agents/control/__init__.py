"""Path-tracking controllers: what they see, how they are tuned, the loop that they close."""
