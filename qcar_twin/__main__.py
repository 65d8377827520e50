"""`python -m qcar_twin COMMAND [options]`: the same as `qcar-twin`, where its folder is not on the path."""

import sys

from qcar_twin.scripts.__main__ import main

if __name__ == "__main__":
  sys.exit(main())
