"""Render the study's references and keep them as half-float EXR: `references.py WORK [NAME …]`.

The state after each pass is kept in the folder WORK, so that an interrupted run goes on.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mi_ellipse  # noqa: F401  # before Mitsuba: it chooses the LLVM
import mitsuba as mi
from mi_ellipse.files.images import read_exr, read_metadata, write_exr
from mi_ellipse.study.reference import render_reference
from rich.progress import Progress

NOTEBOOKS = Path(__file__).resolve().parent
FOLDER = NOTEBOOKS / "references"
SCENES = NOTEBOOKS.parent / "scenes"

# Scene, its parameters, and samples per pixel. The circles are those of the original study.
REFERENCES = {
    "bunny": ("bunny.xml", {"resx": "256", "resy": "256"}, 131072),
    "needles": (
        "bunny.xml",
        {"resx": "256", "resy": "256"}
        | {"left_x": "0.9", "left_y": "0.1", "right_x": "0.9", "right_y": "0.1"},
        32768,
    ),
    "fog": ("spheres_fog.xml", {"resx": "240", "resy": "180"}, 16384),
    "dragon": ("dragon.xml", {"resx": "320", "resy": "240"}, 8192),
    "panel": ("panel.xml", {"resx": "320", "resy": "240"}, 8192),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, metavar="WORK", help="folder of the passes")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(REFERENCES)}")
    arguments = parser.parse_args()

    mi.set_variant("llvm_ad_rgb")
    FOLDER.mkdir(exist_ok=True)
    with Progress() as progress:
        for name in arguments.names or REFERENCES:
            file, parameters, spp = REFERENCES[name]
            task = progress.add_task(name, total=spp)
            work = arguments.work / name / "reference"
            reference = render_reference(
                work,
                SCENES / file,
                parameters,
                spp,
                lambda done, _, task=task: progress.update(task, completed=done),
                progress.print,
            )
            metadata = read_metadata(reference.file) | {
                "scene": file,
                "rmse": f"{reference.errors['rmse']:.3g}",
            }
            image = read_exr(reference.file)
            write_exr(FOLDER / f"{name}.exr", image, metadata, half=True)
            progress.print(f"{name}: its own RMSE is {reference.errors['rmse']:.2g}")


if __name__ == "__main__":
    main()
