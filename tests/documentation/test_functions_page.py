"""The page of functions has every public name, and says of each what a caller must know."""

import importlib
import inspect
import re
from pathlib import Path

import mi_ellipse
import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "functions.md").read_text(encoding="utf-8")
SHOWN = re.findall(r"^::: ([\w.]+)$", PAGE, re.MULTILINE)
FUNCTIONS = [name for name in mi_ellipse.__all__ if inspect.isfunction(getattr(mi_ellipse, name))]


def shown():
    """Objects on the page: those that are named, and the public ones of modules."""
    for path in SHOWN:
        module, _, name = path.rpartition(".")
        thing = getattr(importlib.import_module(module), name)
        yield from (
            (getattr(thing, public) for public in thing.__all__)
            if inspect.ismodule(thing)
            else (thing,)
        )


@pytest.mark.parametrize("name", mi_ellipse.__all__)
def test_public_name_is_shown(name):
    thing = getattr(mi_ellipse, name)
    assert any(thing is other for other in shown()), name
    assert "Parameters\n----------\n" in inspect.getdoc(thing)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_is_described(name):
    """Every parameter, what is returned, errors, and the source."""
    function = getattr(mi_ellipse, name)
    text = inspect.getdoc(function)
    parts = re.split(r"^(\w+)\n-+\n", text, flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    assert list(sections) == ["Parameters", "Returns", "Raises", "Notes"]
    described = re.findall(r"^(\w+)$", sections["Parameters"], re.MULTILINE)
    assert described == list(inspect.signature(function).parameters)
