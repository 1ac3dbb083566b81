"""Decide which LLVM library Dr.Jit loads, and refuse one that would abort the process."""

import ctypes
import os
import sys
import warnings
from pathlib import Path

# `drjit` and `mitsuba` are imported inside the functions: importing them already loads LLVM.

# LLVM 15 and 16 abort the process ("Cannot select: f32 = fminimum") when Dr.Jit compiles a kernel
# for AVX-512; Dr.Jit itself refuses what is older.
MINIMUM_VERSION = 17

# Dr.Jit reads this environment variable while it is imported.
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"

# The Python distribution that carries a libLLVM for Linux on x86-64.
DISTRIBUTION = "karellen-llvm-core"

_accepted = False  # A process uses one LLVM to its end, so one successful check lasts.
_chosen: str | None = None  # What `install` wrote into the environment variable.


class UnsupportedLLVMError(RuntimeError):
    """Dr.Jit has loaded an LLVM that would abort the process."""


def install() -> None:
    """
    Point Dr.Jit to the LLVM that was installed with this package, and guard every LLVM variant.

    A library that the user has chosen through ``DRJIT_LIBLLVM_PATH`` stays, as does one that is in
    use already. Where no distribution provides a library, Dr.Jit searches the system by itself.
    Each of them has to pass :func:`check`.

    Raises
    ------
    UnsupportedLLVMError
        If an LLVM variant is already set and its LLVM is too old.
    """
    global _chosen
    if not os.environ.get(LIBRARY_VARIABLE) and (library := bundled_library()):
        imported_before = "drjit" in sys.modules
        os.environ[LIBRARY_VARIABLE] = _chosen = str(library)
        if imported_before and not _drjit_in_use():
            _reload_llvm()

    import mitsuba as mi

    mi.detail.add_variant_callback(_on_variant_change)
    check()


def check() -> None:
    """
    Refuse an LLVM that is too old; do nothing under other variants.

    Plugins call this when they are built: whoever catches the error of ``mi.set_variant`` and
    carries on is stopped there, and not by an abort.

    Raises
    ------
    UnsupportedLLVMError
        If the current variant uses an LLVM below 17; the message says what to do.
    """
    global _accepted
    if _accepted:
        return

    import mitsuba as mi

    if not (mi.variant() or "").startswith("llvm"):
        return

    version = loaded_version()
    if version is not None and version < (MINIMUM_VERSION,):
        raise UnsupportedLLVMError(
            f"Dr.Jit has loaded LLVM {'.'.join(map(str, version))}"
            f" ({loaded_library() or 'path unknown'}), which aborts the process when a kernel is"
            f" compiled; mi_ellipse needs LLVM {MINIMUM_VERSION} or newer. {_remedy()}"
        )
    _accepted = True


def bundled_library() -> Path | None:
    """Return the libLLVM that was installed along with this package, if there is one."""
    # Importing this takes 0.03 s, which users who chose a library themselves need not pay.
    from importlib import metadata

    try:
        files = metadata.files(DISTRIBUTION) or ()
    except metadata.PackageNotFoundError:
        return None

    for file in files:
        if file.match("libLLVM*.so*"):
            # The links among these names are made at the start of Python, and not in every kind
            # of installation: go by what is there.
            path = Path(file.locate()).resolve()
            if path.is_file():
                return path
    return None


def user_environment() -> dict[str, str]:
    """Return the environment variables without the choice of :func:`install`."""
    environment = dict(os.environ)
    if _chosen is not None and environment.get(LIBRARY_VARIABLE) == _chosen:
        del environment[LIBRARY_VARIABLE]
    return environment


def loaded_version() -> tuple[int, ...] | None:
    """Return the version of the LLVM that Dr.Jit has loaded, or None if it found none."""
    import drjit as dr

    version = dr.detail.llvm_version()
    return version if version[0] > 0 else None


def loaded_library() -> Path | None:
    """Return the LLVM library mapped into this process, where the system can tell (Linux)."""
    try:
        mappings = Path("/proc/self/maps").read_text().splitlines()
    except OSError:
        return None

    paths = {Path(fields[5]) for line in mappings if len(fields := line.split(maxsplit=5)) == 6}
    libraries = sorted(path for path in paths if path.match("libLLVM*.so*"))

    # A process can hold several, for example that of a graphics driver: the one that Dr.Jit was
    # told to use goes first.
    requested = Path(os.environ.get(LIBRARY_VARIABLE, "")).resolve()
    return requested if requested in libraries else next(iter(libraries), None)


def _drjit_in_use() -> bool:
    """Tell whether anything was computed with Dr.Jit, or a variant was set that does."""
    import drjit as dr

    return "No variables registered" not in str(dr.whos(as_string=True)) or any(
        name.startswith(("mitsuba.llvm_", "mitsuba.cuda_", "mitsuba.metal_"))
        for name in sys.modules
    )


def _reload_llvm() -> None:
    """
    Make Dr.Jit, imported before this package and not yet used, load the LLVM it is told to now.

    Dr.Jit has no public function for this. Its core library exports the two functions below, under
    the names that C++ compilers on Linux give to ``jit_shutdown(int)`` and ``jit_init(uint32_t)``;
    a bundled library exists on Linux alone. They take 0.01 s.
    """
    import drjit as dr

    if loaded_version() is None:
        # Dr.Jit does not try again after a search that failed.
        warnings.warn(
            "Dr.Jit was imported before mi_ellipse and found no LLVM: LLVM variants cannot be set."
            f" {_remedy()}",
            stacklevel=4,
        )
        return

    core = ctypes.CDLL(str(Path(dr.__file__).with_name("libdrjit-core.so")))
    core._Z12jit_shutdowni(ctypes.c_int(0))
    backends = (dr.JitBackend.LLVM, dr.JitBackend.CUDA)
    core._Z8jit_initj(ctypes.c_uint32(sum(1 << backend.value for backend in backends)))


def _remedy() -> str:
    """Say how a process gets an LLVM that works."""
    return (
        f"Import mi_ellipse before mitsuba and drjit, or run `pip install {DISTRIBUTION}`"
        f" (Linux x86-64), or set {LIBRARY_VARIABLE} to a libLLVM of version {MINIMUM_VERSION} or"
        " newer; then start Python again."
    )


def _on_variant_change(old: str | None, new: str | None) -> None:
    """Check the LLVM of a variant that was just set; go back to the previous one if it fails."""
    try:
        check()
    except UnsupportedLLVMError:
        import mitsuba as mi

        if old:
            mi.set_variant(old)
        raise
