"""What scripts import from the car's libraries besides the car: control laws, signals, timing, plots."""
