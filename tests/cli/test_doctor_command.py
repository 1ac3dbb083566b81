"""`mi-ellipse doctor` end to end."""

import os
import subprocess
import sys

import drjit as dr
import mi_ellipse
import mitsuba as mi


def run_doctor(**environment):
    return subprocess.run(
        [sys.executable, "-m", "mi_ellipse", "doctor"],
        capture_output=True,
        text=True,
        env=os.environ | environment,
    )


def test_doctor():
    process = run_doctor()
    assert process.returncode == 0, process.stdout
    for word in (mi_ellipse.__version__, mi.__version__, dr.__version__, "llvm_ad_rgb works"):
        assert word in process.stdout


def test_doctor_fails_without_llvm():
    process = run_doctor(DRJIT_LIBLLVM_PATH="/nonexistent")
    assert process.returncode == 1
    assert "llvm_ad_rgb fails: " in process.stdout
    assert "scalar_rgb  works" in process.stdout
    assert "LLVM        none found" in process.stdout
