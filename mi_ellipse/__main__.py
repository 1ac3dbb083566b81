"""Run the command line with ``python -m mi_ellipse``."""

from .cli import main

main()
