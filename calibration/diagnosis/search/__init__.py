"""Structure search: sets of mechanisms refitted side by side, and what may be claimed of them."""
