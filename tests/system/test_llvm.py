"""Which LLVM a process gets, and what happens to one that is too old.

A process loads LLVM once, so every test that loads one runs Python anew.
"""

import ctypes.util
import os
import subprocess
import sys
from importlib import metadata

import pytest
from mi_ellipse.system import llvm

BUNDLED = llvm.bundled_library()
needs_bundled = pytest.mark.skipif(BUNDLED is None, reason="no bundled LLVM on this platform")

# Stands for an LLVM that is too old, on machines that have none.
PRETEND_OLD = "import drjit as dr; dr.detail.llvm_version = lambda: (16, 0, 6)\n"

RENDER = "print('mean', mi.render(mi.load_dict(mi.cornell_box()), spp=1).numpy().mean())\n"
REPORT = "from mi_ellipse.system import llvm; print(llvm.loaded_version(), llvm.loaded_library())\n"


def run(code, library=None, check=True):
    """Run code in a new Python process, by default without a choice of LLVM by the user."""
    environment = llvm.user_environment()
    environment.pop(llvm.LIBRARY_VARIABLE, None)
    if library is not None:
        environment[llvm.LIBRARY_VARIABLE] = str(library)
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment
    )
    assert not check or process.returncode == 0, process.stderr
    return process


# ---- The library that comes along ----


@needs_bundled
@pytest.mark.parametrize(
    "before",
    [
        "",
        "import drjit\n",
        "import mitsuba as mi\n",
        "import mitsuba as mi; mi.set_variant('scalar_rgb')\n",
    ],
)
def test_bundled_library_is_used(before):
    if before and run("import drjit; print(drjit.detail.llvm_version()[0])").stdout == "-1\n":
        pytest.skip("Dr.Jit searches once, and this machine has no LLVM of its own")
    code = before + "import mi_ellipse, mitsuba as mi; mi.set_variant('llvm_ad_rgb')\n"
    assert str(BUNDLED) in run(code + RENDER + REPORT).stdout.splitlines()[-1]


@needs_bundled
def test_choice_of_the_user_stays(tmp_path):
    chosen = tmp_path / "libLLVM-chosen.so"
    chosen.symlink_to(BUNDLED)
    code = "import mi_ellipse, os; print(os.environ['DRJIT_LIBLLVM_PATH'])"
    assert run(code, chosen).stdout.strip() == str(chosen)


@needs_bundled
def test_variant_set_before_the_import_keeps_working():
    code = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import mi_ellipse\n"
    assert "mean 0.1" in run(code + RENDER, BUNDLED).stdout


@needs_bundled
def test_arrays_made_before_the_import_survive():
    code = "from drjit.llvm import Float; x = Float(1, 2)\nimport mi_ellipse\nprint(x + 1)"
    assert run(code, BUNDLED).stdout.strip() == "[2, 3]"
    if run("import drjit; print(drjit.detail.llvm_version()[0])").stdout != "-1\n":
        code = "from drjit.llvm import Float; x = Float([1, 2])\nimport mi_ellipse\nprint(len(x))"
        assert run(code).stdout.strip() == "2"


def test_no_distribution_leaves_the_search_to_drjit(monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "files", absent)
    assert llvm.bundled_library() is None


def test_library_that_an_installer_left_out_is_not_chosen(monkeypatch, tmp_path):
    class Missing(metadata.PackagePath):
        def locate(self):
            return tmp_path / self.name

    monkeypatch.setattr(metadata, "files", lambda name: [Missing("lib/libLLVM.so.23.1")])
    assert llvm.bundled_library() is None
    (tmp_path / "libLLVM.so.23.1").touch()
    assert llvm.bundled_library() == tmp_path / "libLLVM.so.23.1"


# ---- Refusal of an old one ----


def test_old_llvm_is_refused_when_its_variant_is_set():
    process = run(
        PRETEND_OLD + "import mi_ellipse, mitsuba as mi; mi.set_variant('scalar_rgb')\n"
        "try: mi.set_variant('llvm_ad_rgb')\n"
        "except RuntimeError as error: print(mi.variant(), error)"
    )
    assert process.stdout.startswith("scalar_rgb Dr.Jit has loaded LLVM 16.0.6")
    for remedy in ("Import mi_ellipse before", "pip install karellen-llvm-core", "DRJIT_LIBLLVM"):
        assert remedy in process.stdout


def test_old_llvm_is_refused_at_import():
    code = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb')\n" + PRETEND_OLD
    process = run(code + "import mi_ellipse", BUNDLED, check=False)
    assert process.returncode == 1
    assert "UnsupportedLLVMError: Dr.Jit has loaded LLVM 16.0.6" in process.stderr


def test_plugins_refuse_old_llvm_after_an_error_that_was_ignored():
    process = run(
        PRETEND_OLD + "import mi_ellipse, mitsuba as mi\n"
        "from mi_ellipse.system import llvm\n"
        "try: mi.set_variant('llvm_ad_rgb')\n"
        "except llvm.UnsupportedLLVMError: print(mi.variant())\n"
        "try: llvm.check()\n"
        "except llvm.UnsupportedLLVMError: print('refused')"
    )
    assert process.stdout.split() == ["llvm_ad_rgb", "refused"]


def test_old_llvm_does_not_matter_to_scalar_variants():
    code = PRETEND_OLD + "import mi_ellipse, mitsuba as mi; mi.set_variant('scalar_rgb')\n"
    assert "mean 0.1" in run(code + RENDER).stdout


def test_really_old_llvm_ends_in_an_exception_and_not_in_an_abort():
    old = ctypes.util.find_library("LLVM-15") or ctypes.util.find_library("LLVM-16")
    if old is None:
        pytest.skip("no LLVM 15 or 16 on this machine")
    code = "import mi_ellipse, mitsuba as mi; mi.set_variant('llvm_ad_rgb')\n"
    process = run(code + RENDER, old, check=False)
    assert process.returncode == 1
    assert "UnsupportedLLVMError: Dr.Jit has loaded LLVM 1" in process.stderr


# ---- Cost of the import ----


def test_import_leaves_heavy_modules_out():
    names = ("matplotlib", "rich", "scipy", "typer")
    code = f"import mi_ellipse, sys; print([name for name in {names} if name in sys.modules])"
    assert run(code).stdout.split("\n")[0] == "[]"


def test_environment_of_the_user_lacks_only_our_choice(monkeypatch):
    monkeypatch.setenv(llvm.LIBRARY_VARIABLE, "ours")
    monkeypatch.setattr(llvm, "_chosen", "ours")
    expected = dict(os.environ)
    del expected[llvm.LIBRARY_VARIABLE]
    assert llvm.user_environment() == expected
    monkeypatch.setenv(llvm.LIBRARY_VARIABLE, "theirs")
    assert llvm.user_environment()[llvm.LIBRARY_VARIABLE] == "theirs"
