"""The learning agent: environments, training, its policy as data."""
