"""State estimation: local extended Kalman filters, the master that fuses them, online and offline."""
