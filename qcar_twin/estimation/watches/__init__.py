"""What watches sensors, stamps, silences and the model of each car for faults."""
