"""What all commands share."""

import subprocess
import sys

import mi_ellipse
import pytest
from commands import invoke


def test_version():
    result = invoke("--version")
    assert (result.exit_code, result.stdout) == (0, f"mi-ellipse {mi_ellipse.__version__}\n")
    process = subprocess.run(
        [sys.executable, "-m", "mi_ellipse", "--version"], capture_output=True, text=True
    )
    assert process.stdout == result.stdout


def test_help_lists_the_commands():
    result = invoke("--help")
    for command in ("render", "compare", "report", "doctor"):
        assert f" {command} " in result.stdout


@pytest.mark.parametrize("definition", ["width", "=3"])
def test_malformed_definitions(definition):
    result = invoke("render", "scene.xml", "-D", definition)
    assert result.exit_code == 2
    assert "-D takes NAME=VALUE" in " ".join(result.stderr.split())
