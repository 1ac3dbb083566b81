"""The page on illuminance: its command prints what it says, and its example runs."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

from commands import invoke

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "illuminance.md").read_text(encoding="utf-8")


def test_command_prints_what_the_page_says(tmp_path):
    command = re.search(r"^    mi-ellipse (illuminance .*) -o office.csv$", PAGE, re.MULTILINE)[1]
    command = command.replace("scenes/", f"{ROOT}/scenes/")
    result = invoke(*shlex.split(command), "-o", tmp_path / "office.csv")
    assert result.exit_code == 0, result.output
    *printed, files = result.stdout.splitlines()
    assert files.startswith(str(tmp_path / "office.csv"))
    assert "".join(f"    {line}\n" for line in printed) in PAGE


def test_example_runs():
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    code += (
        "assert value.shape == error.shape == (2,) and (0 < error).all() and (error < value).all()"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
