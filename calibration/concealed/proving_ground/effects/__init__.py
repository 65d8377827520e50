"""The registry of concealed effects: every file of this folder adds its classes by being imported."""

from importlib import import_module
from pkgutil import iter_modules

from .base import EFFECTS, Effect, effect_class

for _module in iter_modules(__path__):
  import_module(f"{__name__}.{_module.name}")

__all__ = ["EFFECTS", "Effect", "effect_class"]
