"""What watches one car's sensors for faults: encoder and stamps, gyro."""
