"""The command lines: `qcar-twin COMMAND`, one file each."""
