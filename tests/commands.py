"""Commands run in this process, and the scene that they run on."""

from __future__ import annotations

from pathlib import Path

import click
import mitsuba as mi
import numpy as np
from mi_ellipse import cli
from typer.testing import CliRunner

WIDTH, HEIGHT = 16, 12

LAMP = """
<shape type="disk">
    <transform name="to_world"><rotate x="1" angle="180"/><translate z="2"/></transform>
    <emitter type="ellipticalarea"><string name="sampling" value="$sampling"/></emitter>
</shape>
"""

SCENE = f"""
<scene version="3.0.0">
    <default name="sampler" value="independent"/>
    <default name="sampling" value="solid_angle"/>
    <default name="pixel_format" value="rgb"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,-4,3" target="0,0,0" up="0,0,1"/></transform>
        <sampler type="$sampler"><integer name="sample_count" value="4"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{WIDTH}"/>
            <integer name="height" value="{HEIGHT}"/>
            <string name="pixel_format" value="$pixel_format"/>
        </film>
    </sensor>
    <shape type="rectangle"><transform name="to_world"><scale value="3"/></transform></shape>
    {{lamps}}
</scene>
"""


def write_scene(path: Path, lamps: str) -> Path:
    """Write the scene with these lamps."""
    path.write_text(SCENE.format(lamps=lamps))
    return path


def invoke(*arguments: object) -> click.testing.Result:
    """Run `mi-ellipse` with arguments."""
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def read(path: str | Path) -> np.ndarray:
    """Pixels of a picture, as Mitsuba reads them."""
    return np.array(mi.Bitmap(str(path)))


def files(folder: Path) -> list[str]:
    """Names of the files in a folder."""
    return sorted(path.name for path in folder.iterdir())


def samples(spp: int) -> int:
    """Number of samples of the scene's film, without border, at `spp`."""
    return WIDTH * HEIGHT * spp
