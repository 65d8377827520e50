"""A physics digital twin of a 1:10 robotic car in MuJoCo."""
