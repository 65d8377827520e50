"""What watches sensors, stamps and the model of each car for faults."""
