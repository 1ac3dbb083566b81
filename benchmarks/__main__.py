"""Run the benchmarks: ``python -m benchmarks [NAME]… [--pairs N]``; all of them by default.

``python -m benchmarks figures`` measures nothing and writes the figures of the pages anew.
"""

from __future__ import annotations

import argparse
import json
from importlib import import_module
from inspect import signature
from pathlib import Path

import mitsuba as mi

from . import figures

DATA = Path(__file__).parent.parent / "docs" / "data"
NAMES = (
    "accuracy",
    "calls",
    "render_time",
    "error",
    "choice",
    "lamps",
    "first_frame",
    "growth",
    "ellipsoids",
    "bulbs",
    "existing",
    "groups",
    "study",
    "cluster",
)
FIGURES = "figures"


def main() -> None:
    """Measure, print, and keep the figures in `docs/data`."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help=f"{', '.join(NAMES)}; all by default; figures: no measurement, the pages anew",
    )
    parser.add_argument(
        "--pairs", type=int, help="timed pairs, where a benchmark has them; 40 by default"
    )
    arguments = parser.parse_args()
    if arguments.names == [FIGURES]:
        figures.write()
        return
    if unknown := set(arguments.names) - set(NAMES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(NAMES)}")

    mi.set_variant("llvm_ad_rgb")
    from . import harness, report

    for name in arguments.names or NAMES:
        print(f"---- {name}: {harness.machine()} ----", flush=True)
        if name == "accuracy":
            import_module(".accuracy", __package__).main([])
            figures.write()
            continue
        run = import_module(f".{name}", __package__).run
        document: dict[str, object] = {"machine": harness.machine()}
        if (timed := signature(run).parameters.get("pairs")) is not None:
            document["pairs"] = arguments.pairs or timed.default
            document[name] = run(pairs=document["pairs"])
        else:
            document[name] = run()
        if document[name] is None:  # Its scenes are missing, which it has said
            continue
        DATA.mkdir(parents=True, exist_ok=True)
        (DATA / f"{name}.json").write_text(json.dumps(document, indent=1) + "\n")
        report.write()
        figures.write()


if __name__ == "__main__":
    main()
