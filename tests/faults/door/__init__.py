"""The door on trial: falsities of driven sessions, real logs and formulas, through `new`, `check` and `calibrate`."""
