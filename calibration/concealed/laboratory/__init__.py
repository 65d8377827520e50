"""What the simulated cars share: manoeuvres, session designs, the driver, what is written to disk, the sealed truth."""
