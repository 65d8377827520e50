"""Where simulation and recordings differ, what physics was left out, and what the fit gains by it.

One stage a file: passport, recalibrate, detect, locate, scan, search, unknown, decide, ship.
"""
