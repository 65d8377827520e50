"""Sessions of cars that others wrote: each generator is a published simulator, driven by the laboratory's driver.

Needs the extra `exam` (`pip install qcar-twin[exam]`); nothing else in the project imports these packages.
"""
