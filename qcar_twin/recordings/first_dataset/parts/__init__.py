"""Files that hold parts of one drive: which belong together, how their clocks lie, and one log of them."""
