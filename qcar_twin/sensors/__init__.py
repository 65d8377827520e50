"""Synthetic sensors: IMU, encoder and lidar with noise, latency, dropouts and spikes."""
