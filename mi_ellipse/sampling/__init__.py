"""Sampling strategies, one file each; a file registers what it defines."""

from importlib import import_module
from pkgutil import iter_modules

from .strategy import DEFAULT, STRATEGIES, find

for _module in iter_modules(__path__):
    import_module(f".{_module.name}", __name__)
# Files import each other, so the order of the registrations says nothing.
for _name in sorted(STRATEGIES):
    STRATEGIES[_name] = STRATEGIES.pop(_name)

__all__ = ["DEFAULT", "STRATEGIES", "find"]
