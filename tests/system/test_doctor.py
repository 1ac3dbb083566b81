"""Trials of variants, in processes of their own that may die."""

import signal
import sys

import pytest
from mi_ellipse.system import doctor


def test_doctor_survives_an_abort():
    code = "import os, sys; print('LLVM ERROR: no', file=sys.stderr, flush=True); os.abort()"
    trial = doctor.try_variant("llvm_ad_rgb", (sys.executable, "-c", code))
    assert not trial.works
    assert trial.message == f"died of signal {int(signal.SIGABRT)}: LLVM ERROR: no"


def test_doctor_tries_one_variant_of_each_backend():
    variants = ["scalar_mono", "scalar_rgb", "llvm_mono", "llvm_ad_rgb", "cuda_rgb"]
    assert doctor.representatives(variants) == ["scalar_mono", "llvm_ad_rgb", "cuda_rgb"]


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import sys; sys.exit(3)", "(exit code 3): it left no message"),
        ("raise ImportError('no mitsuba')", "(exit code 1): ImportError: no mitsuba"),
        ("print('something else')", "(exit code 0): it left no message"),
        ("print('[1, 2]')", "(exit code 0): it left no message"),
    ],
)
def test_doctor_survives_a_child_without_a_report(code, message):
    trial = doctor.try_variant("llvm_ad_rgb", (sys.executable, "-c", code))
    assert not trial.works
    assert trial.message == f"ended without a report {message}"
    assert trial.llvm == ""
