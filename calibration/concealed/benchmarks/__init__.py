"""Speed and accuracy in pairs, each in one run."""
