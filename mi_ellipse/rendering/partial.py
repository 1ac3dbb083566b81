"""Keep an interrupted render in the file of its picture, and continue it from there."""

from __future__ import annotations

import json
from pathlib import Path

from ..files import images
from . import provenance
from .job import Plan, RenderJob
from .passes import NOTHING, Finished, Rendering, check_continuation

# In the metadata: the samples per pixel that the whole render should have, and its channels
PLANNED_SPP = "planned_spp"
CHANNELS = "channel_names"


def write(path: Path, job: RenderJob, plan: Plan, rendering: Rendering) -> None:
    """
    Write an interrupted render: its picture so far, and the exact sum to go on from.

    Parameters
    ----------
    path
        OpenEXR file, replaced whole.
    job, plan
        The render.
    rendering
        What is finished of it.
    """
    assert rendering.unfinished is not None
    metadata = {
        **provenance.describe(job, rendering),
        **_settings(job, plan),
        PLANNED_SPP: str(plan.spp),
        CHANNELS: json.dumps(rendering.channels),
    }
    total = rendering.unfinished.total
    images.write_with_sum(path, rendering.image, total, metadata, rendering.channels)


def read(path: Path, job: RenderJob, plan: Plan) -> Finished:
    """
    Return what a file holds of a render; nothing, if it holds no interrupted render at all.

    Raises
    ------
    ValueError
        If the render in the file had other settings, or holds more samples than the job wants.
    """
    found = _metadata(path)
    if PLANNED_SPP not in found:
        return NOTHING
    wanted = _settings(job, plan)
    if other := [name for name, value in wanted.items() if found.get(name) != value]:
        raise ValueError(
            f"{path} holds an unfinished render of {found['spp']} samples per pixel with other"
            f" settings ({', '.join(other)}): remove it or choose another output"
        )
    total = images.read_sum(path, tuple(json.loads(found[CHANNELS])))
    spp, passes = int(found["spp"]), int(found["passes"])
    finished = Finished(total, spp, passes, float(found["render_seconds"]))
    try:
        check_continuation(plan.sizes, finished)
    except ValueError as error:
        raise ValueError(f"{path} cannot be continued: {error}") from None
    return finished


def _settings(job: RenderJob, plan: Plan) -> dict[str, str]:
    settings = provenance.settings(job, plan.scene_digest)
    return settings | {"picture_digest": provenance.picture_digest()}


def _metadata(path: Path) -> dict[str, str]:
    """Return the attributes of a file; none, if it does not exist or is no OpenEXR file."""
    try:
        return images.read_metadata(path)
    except (OSError, ValueError):
        return {}
