"""Real recordings without a key: what acts on sensors and commands put into them, and sets split in halves."""
