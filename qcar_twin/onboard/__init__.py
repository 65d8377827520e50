"""The QCar's own interface: a script written for the car is run unchanged on a simulated one, on simulated time."""
